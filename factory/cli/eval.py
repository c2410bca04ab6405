"""`factory eval`: evaluates policies in closed loop on a dataset, writes evaluation episodes, and compares policies."""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.groups import DefaultCommand, DefaultGroup
from factory.cli.options import (
    DIRECTORY,
    appearance_option,
    connect_option,
    count_option,
    json_option,
    listen_option,
    number_option,
    place_argument,
    policy_limit_options,
    renderer_option,
    rig_option,
    split_filter,
    tls_option,
    workers_option,
    write_option,
)
from factory.eval.models.result import MAX_LATENCY_MS, REAL, Latency, Variant
from schemas.errors import UsageError
from schemas.terms import Split

if TYPE_CHECKING:
    from factory.eval.models.spec import SpecSet
    from factory.eval.remote.fleet import FleetAccess
    from factory.eval.results.score import Evaluation
    from factory.eval.results.store import Store
    from factory.eval.specs.campaign import Campaign
    from schemas.storage.place import Place
    from schemas.terms import RendererKind

_RESULTS = click.Path(path_type=Path)
_split_option = split_filter(
    f"Split to include; repeatable. Values: {', '.join(Split)}, all (also the training splits train_id and val_id). "
    "Default: all episodes of the test splits."
)


@click.group("eval", cls=DefaultGroup)
def command() -> None:
    """Evaluate policies in closed loop on the episodes of a dataset."""


@click.command("run", cls=DefaultCommand, hidden=True)
@click.argument("root", metavar="DIR", type=DIRECTORY)
@_split_option
@click.option(
    "--policy",
    "policies",
    multiple=True,
    metavar="[NAME=]POLICY",
    help="Policy to evaluate, see above, and its name in the results; repeatable.",
)
@click.option(
    "--specs",
    "specs_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="File of evaluation episodes, written by `factory eval specs`. Default: the episodes of the dataset.",
)
@click.option(
    "--ablate-language", is_flag=True, help="Also evaluate with shuffled, wrong-category and empty instructions."
)
@count_option("--episodes", None, "Number of episodes, selected at even intervals. Default: all.")
@workers_option("Number of simulation processes on this machine")
@listen_option("Endpoint to listen on; `factory worker` processes that connect run the episodes. Repeatable.")
@connect_option("Endpoint of a running coordinator whose workers run the episodes; repeatable.")
@tls_option
@write_option(
    "DIR",
    "Output directory. An interrupted evaluation with the same options is continued. Default: no output files.",
)
@policy_limit_options
@click.option(
    "--latency",
    callback=lambda _context, _option, value: _latency_of(value),
    metavar="MS|real",
    help="Time that passes in the simulation for each answer of a policy, milliseconds: the robot keeps its former "
    "command. real: the measured time, which is not reproducible. Default: the simulation waits for the policy.",
)
@click.option(
    "--pose", "with_pose", is_flag=True, help="Add the robot's pose, in the start frame, to the observations."
)
@rig_option(
    "Sensors that policies get: a built-in rig or a TOML file. A policy that needs another sensor is refused. Default: "
    "the recorded camera."
)
@appearance_option("Default: the scenes as they were compiled.")
@click.option(
    "--restart",
    is_flag=True,
    help="Evaluate the policies again; their former results are kept in the folder `former` of -o.",
)
@count_option("--videos", 12, "Maximum number of videos of failed episodes for each policy.", least=0)
@click.option("--tables", "all_tables", is_flag=True, help="Also print tables by scene, tier, category and template.")
@renderer_option
@json_option
def run(
    root: Path,
    splits: tuple[str, ...] | None,
    policies: tuple[str, ...],
    specs_path: Path | None,
    ablate_language: bool,
    episodes: int | None,
    workers: int | None,
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    tls: Path | None,
    out: Path | None,
    act_timeout: float,
    load_timeout: float,
    latency: Latency | None,
    with_pose: bool,
    rig: str | None,
    appearance: str | None,
    restart: bool,
    videos: int,
    all_tables: bool,
    renderer: RendererKind,
    as_json: bool,
) -> int:
    """Evaluate policies in closed loop on the episodes of a dataset.

    \b
    POLICY is one of
      built-in:  expert, planner, random, stop, bc:DIR,
                 replay (recorded actions of the same episode),
                 playback (recorded actions of another episode)
      a class:   package.module:Class (see docs/evaluation/README.md)
      a server:  ws://HOST:PORT (openpi's protocol: WebSocket and msgpack)
    NAME=POLICY gives a policy a name, e.g. act=ws://127.0.0.1:8401.

    Writes episodes.parquet, results.json and index.html to --out. The same command continues an interrupted evaluation.
    """
    from factory.eval.order import EvalOptions, make_campaign
    from factory.eval.results.text import print_evaluation
    from factory.support.logs import configure_logs
    from factory.support.terminal import print_result

    if restart and out is None:
        raise UsageError("--restart requires -o DIR, the folder of the former results")
    configure_logs()
    access = _network_access(listen, connect, tls=tls, out=out, workers=workers)
    options = EvalOptions(
        root=root,
        splits=splits,
        policies=policies,
        specs_path=specs_path,
        ablate_language=ablate_language,
        episodes=episodes,
        workers=workers,
        act_timeout=act_timeout,
        load_timeout=load_timeout,
        with_pose=with_pose,
        renderer=renderer,
        rig=rig,
        appearance=appearance,
        latency=latency,
    )
    campaign = make_campaign(options, drives_here=access is None)

    def show(evaluation: Evaluation) -> None:
        print_result(evaluation, as_json, lambda result: print_evaluation(result, all_tables))

    return _evaluate(campaign, access, out, restart=restart, videos=videos, show=show)


command.set_default(run)


def _latency_of(value: str | None) -> Latency | None:
    if value is None or value == REAL:
        return None if value is None else REAL
    try:
        milliseconds = float(value)
    except ValueError:
        milliseconds = -1.0
    if not 0 <= milliseconds <= MAX_LATENCY_MS:
        raise UsageError(f"--latency {value}: give 0 to {MAX_LATENCY_MS:g} milliseconds, such as 100, or real")
    return milliseconds


def _evaluate(
    campaign: Campaign,
    access: FleetAccess | None,
    out: Path | None,
    *,
    restart: bool,
    videos: int,
    show: Callable[[Evaluation], None],
) -> int:
    """Runs a campaign and returns the exit code.

    Args:
        campaign: the campaign.
        access: network access to remote workers; `None` if this machine runs the episodes.
        out: output directory, or `None`.
        restart: whether to move former results of the policies aside.
        videos: maximum number of videos for each policy.
        show: prints the evaluation.
    """
    from factory.eval.order import open_store, published, require_same_policies
    from factory.eval.results.publish import evaluation_of
    from factory.eval.results.summary_text import resolution

    if len(campaign.policies) > 1:
        comparisons = math.comb(len(campaign.policies), 2)
        click.echo(f"{resolution(len(campaign.specs.specs), comparisons)}; see `factory eval power`", err=True)
    with ExitStack() as stack:
        folder = out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="eval-")))
        store = stack.enter_context(open_store(campaign, folder))
        for name in campaign.policies if restart else ():
            if (former := store.set_aside(name)) is not None:
                click.echo(f"former results of {name}: {former}", err=True)
        if access is None:
            require_same_policies(campaign, store)
        if not _drive(campaign, store, access):
            kept = "run the same command again to continue" if out else "the results were not stored: use -o DIR"
            click.echo(f"interrupted: {kept}", err=True)
            return 130
        evaluation = published(campaign, store, videos) if out else evaluation_of(campaign, store)
        show(evaluation)
        if out:
            click.echo(f"results in {out}: results.json, episodes.parquet, index.html", err=True)
            _print_repeat_command(evaluation)
    return _exit_code_of(evaluation)


def _drive(campaign: Campaign, store: Store, access: FleetAccess | None) -> bool:
    from factory.dataset.reader import Dataset
    from factory.eval.order import pace_bars
    from factory.eval.process.local_campaign import run_campaign
    from factory.eval.remote.fleet import run_fleet
    from workers.client.stopping import stop_on_signals

    with stop_on_signals() as (stop, _), pace_bars(campaign) as on_progress:
        if access is None:
            return run_campaign(campaign, store, stop, on_progress)
        return run_fleet(
            campaign, Dataset(campaign.root).meta.plan, store=store, access=access, stop=stop, tell=on_progress
        )


def _print_repeat_command(evaluation: Evaluation) -> None:
    if any(policy.faults for policy in evaluation.policies):
        click.echo(
            "note: results with policy faults are kept; to evaluate a corrected policy, add --restart to the command",
            err=True,
        )


def _exit_code_of(evaluation: Evaluation) -> int:
    """Returns the exit code: 1 if a policy had a fault in every episode, because such a policy was not evaluated."""
    lost = [policy.policy for policy in evaluation.policies if policy.only_failed]
    for name in lost:
        click.echo(f"error: policy {name} had a fault in every episode, so it was not evaluated", err=True)
    return 1 if lost else 0


def _network_access(
    listen: tuple[str, ...], connect: tuple[str, ...], *, tls: Path | None, out: Path | None, workers: int | None
) -> FleetAccess | None:
    """Returns the network access to remote workers; `None` if this machine runs the episodes."""
    if not (listen or connect):
        if tls is not None:
            raise UsageError("--tls requires --listen or --connect; give one of them, or remove --tls")
        return None
    if out is None:
        raise UsageError("--listen and --connect require -o DIR, where the results of the workers are stored")
    if workers is not None:
        raise UsageError(
            "--workers cannot be combined with --listen or --connect: remove it and start `factory worker` on each host"
        )
    from coordinator.protocol.tls import Guard
    from factory.eval.remote.fleet import FleetAccess
    from factory.support.listen import choose_listening, require_loopback, require_tls_endpoints

    if tls is not None and connect:
        if listen:
            raise UsageError(
                "--tls with both --listen and --connect is not supported, because a certificate has one role: give one "
                "of them"
            )
        require_tls_endpoints(connect)
        return FleetAccess((), connect, Guard(tls, listens=False), _print_worker_command)
    require_loopback(connect)
    guard, endpoints = choose_listening(tls, listen) if listen else (None, ())
    return FleetAccess(endpoints, connect, guard, _print_worker_command)


def _print_worker_command(endpoints: tuple[str, ...]) -> None:
    for endpoint in endpoints:
        click.echo(f"factory worker --cores 2 --connect {endpoint}", err=True)


@command.command("specs")
@place_argument
@_split_option
@click.option(
    "--unfiltered", is_flag=True, help="Sample new start states, including those where the expert would fail."
)
@count_option("--episodes", None, "Number of episodes. Default: all; with --unfiltered: 100.")
@count_option("--seed", 0, "Random seed of --unfiltered.", least=0)
@write_option("FILE", "JSON file to write.", required=True)
@json_option
def specs(
    root: Place,
    splits: tuple[str, ...] | None,
    unfiltered: bool,
    episodes: int | None,
    seed: int,
    out: Path,
    as_json: bool,
) -> int:
    """Write the evaluation episodes of a dataset to a file.

    Evaluations with the same specs file use the same episodes.
    """
    from factory.dataset.reader import Dataset
    from factory.eval.models.spec import write_specs
    from factory.eval.specs.from_dataset import specs_of_dataset, splits_of
    from factory.eval.specs.unfiltered import unfiltered_specs
    from factory.support.logs import configure_logs
    from factory.support.terminal import one_bar, print_json
    from workers.sim.context import SimulationContext

    configure_logs()
    dataset = Dataset(root)
    chosen = splits_of(dataset, splits)
    with one_bar("start states") as on_progress:
        if unfiltered:
            with SimulationContext() as context:
                result = unfiltered_specs(
                    dataset, chosen, episodes or 100, seed=seed, context=context, tell=on_progress
                )
        else:
            result = specs_of_dataset(dataset, chosen, on_progress, episodes)
    write_specs(result, out)
    if as_json:
        print_json(_specs_data(result, out))
    else:
        _print_specs(result, out)
    return 0


def _specs_data(specs: SpecSet, out: Path) -> dict[str, object]:
    return {
        "file": str(out),
        "digest": specs.digest,
        "source": specs.source,
        "episodes": len(specs.specs),
        "splits": dict(Counter(str(spec.split) for spec in specs.specs)),
        "tiers": dict(Counter(str(spec.tier) for spec in specs.specs)),
        "scenes": dict(Counter(spec.scene for spec in specs.specs)),
        "starts": dict(Counter(spec.spawn_source for spec in specs.specs)),
        "target_in_view": sum(spec.is_target_in_view for spec in specs.specs),
        "two_or_more_categories_in_view": sum(len(spec.categories_in_view) > 1 for spec in specs.specs),
        "without_way": sum(spec.geodesic_m is None for spec in specs.specs),
    }


def _print_specs(specs: SpecSet, out: Path) -> None:
    from factory.support.terminal import print_table

    summary = _specs_data(specs, out)
    rows = [
        (split, sum(spec.split == split for spec in specs.specs))
        for split in Split
        if any(spec.split == split for spec in specs.specs)
    ]
    print_table("", ("split", "episodes"), rows)
    click.echo(f"{len(specs.specs)} episodes: {specs.source}")
    click.echo(
        f"target in view at the start: {summary['target_in_view']}; two or more categories in view: "
        f"{summary['two_or_more_categories_in_view']}; no path on the floor: {summary['without_way']}"
    )
    click.echo(f"written to {out}, digest {specs.digest[:16]}")


@command.command("compare")
@click.argument("results", metavar="OUT|A B...", type=_RESULTS, nargs=-1, required=True)
@click.option(
    "--variant",
    type=click.Choice([str(v) for v in Variant]),
    default="original",
    show_default=True,
    help="Instruction variant to compare.",
)
@write_option("DIR", "Folder for the page comparison.html. Default: no page.")
@click.option(
    "--dataset",
    type=DIRECTORY,
    metavar="DIR",
    help="Dataset of the evaluations, whose scenes the videos of the page need. Default: a page without videos.",
)
@count_option("--videos", 12, "Maximum number of videos for each pair of policies.", least=0)
@json_option
def compare(
    results: tuple[Path, ...], variant: str, out: Path | None, dataset: Path | None, videos: int, as_json: bool
) -> int:
    """Compare policies on the episodes that they share.

    Each policy is compared with each. OUT is the -o of `factory eval` with several policies. A and B are folders
    OUT/policies/NAME, e.g. OUT/policies/bc:bc, or OUT if it contains one policy. With more than two policies, tests and
    intervals are corrected for the number of comparisons.
    """
    from factory.eval.results.compare import compare_all, require_common
    from factory.eval.results.publish import COMPARISON_FILE, publish_comparison
    from factory.eval.results.store import read_policies
    from factory.eval.results.text import print_comparison
    from factory.support.terminal import one_bar, print_json

    if dataset is not None and out is None:
        raise UsageError("--dataset requires -o DIR, the folder of the page")
    runs, kind = read_policies(results), Variant(variant)
    if out is None:
        comparisons = require_common(compare_all([run.results for run in runs], kind), kind)
    else:
        with one_bar("videos of different episodes") as on_progress:
            comparisons = publish_comparison(runs, kind, out, dataset, videos, on_progress)
    if as_json:
        data = [comparison.model_dump(mode="json") for comparison in comparisons]
        print_json(data[0] if len(data) == 1 else {"comparisons": data})
    else:
        for comparison in comparisons:
            print_comparison(comparison)
    if out is not None:
        click.echo(f"page: {out / COMPARISON_FILE}", err=True)
    return 0


@command.command("power")
@count_option("--episodes", None, "Number of episodes that all policies run.")
@number_option("POINTS", "--points", None, "Difference of two success rates, percentage points.", least=0.1, most=100.0)
@count_option("--policies", 2, "Number of policies, each compared with each.", least=2)
@number_option(
    "PERCENT",
    "--differ",
    20.0,
    "Share of the episodes that exactly one of two policies completes, per cent.",
    least=1.0,
    most=100.0,
)
@json_option
def power(episodes: int | None, points: float | None, policies: int, differ: float, as_json: bool) -> int:
    """Print which difference of success rates some episodes resolve.

    A difference is resolved if the exact McNemar test at 5 % finds it with a probability of 80 %.
    """
    from factory.eval.results.estimate import MOST_PAIRS, needed_pairs, resolved_difference
    from factory.support.terminal import print_json

    if (episodes is None) == (points is None):
        raise UsageError("give --episodes N for the points that they resolve, or --points D for the episodes needed")
    comparisons = math.comb(policies, 2)
    if episodes is not None:
        least = resolved_difference(episodes, comparisons, differ / 100)
        points = None if least is None else 100 * least
    elif points is not None:
        episodes = needed_pairs(points / 100, comparisons, differ / 100)
    if as_json:
        print_json({"episodes": episodes, "points": points, "comparisons": comparisons, "differ": differ})
    elif points is None:
        click.echo(f"{episodes} episodes resolve no difference: the test cannot reject with so few")
    elif episodes is None:
        click.echo(f"{points:g} points need more than {MOST_PAIRS} episodes")
    else:
        click.echo(
            f"{episodes} episodes resolve {points:.1f} points of SR ({comparisons} comparison"
            f"{'' if comparisons == 1 else 's'}; the policies end differently in {differ:g} % of the episodes)"
        )
    return 0
