"""`factory eval`: evaluates policies in closed loop on a dataset; prints each measure with its interval."""

from __future__ import annotations

import shlex
import tempfile
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import click

from coordinator.protocol.tls import Guard
from factory.cli.common.admission import choose_listening
from factory.cli.common.groups import DefaultCommand, DefaultGroup
from factory.cli.common.options import (
    appearance_option,
    connect_option,
    count_option,
    former_option,
    listen_option,
    number_option,
    renderer_option,
    rig_option,
    tls_option,
    workers_option,
    write_option,
)
from factory.cli.common.output import json_option, print_result
from factory.cli.common.places import DIRECTORY
from factory.cli.eval.campaign import EvalOptions, eval_split_filter, make_campaign, open_store, pace_bars, published
from factory.cli.eval.compare import command as compare_command
from factory.cli.eval.specs import command as specs_command
from factory.cli.eval.tables import print_evaluation
from factory.dataset.reader import Dataset
from factory.eval.process.run import run_campaign
from factory.eval.remote.fleet import FleetAccess, run_fleet
from factory.eval.results.publish import evaluation_of
from factory.eval.results.score import Evaluation
from factory.eval.results.store import Store
from factory.eval.specs.campaign import Campaign
from factory.support.listen import require_loopback, require_tls_endpoints
from factory.support.logs import configure_logs
from schemas.errors import UsageError
from workers.client.stopping import stop_on_signals


@click.group("eval", cls=DefaultGroup)
def command() -> None:
    """Evaluate policies in closed loop on the episodes of a dataset."""


@click.command("run", cls=DefaultCommand, hidden=True)
@click.argument("root", metavar="DIR", type=DIRECTORY)
@former_option("--data", "root", "DIR", type=DIRECTORY)
@eval_split_filter
@click.option(
    "--policy", "policies", multiple=True, metavar="POLICY", help="Policy to evaluate, see above; repeatable."
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
@number_option("SECONDS", "--act-timeout", 10.0, "Timeout for each action, seconds.", least=0.01)
@number_option(
    "SECONDS", "--load-timeout", 300.0, "Timeout for loading the policy and for each reset, seconds.", least=0.1
)
@click.option(
    "--pose", "with_pose", is_flag=True, help="Add the robot's pose, in the start frame, to the observations."
)
@rig_option(
    "Sensors that policies get: a built-in rig or a TOML file. A policy that needs another sensor is refused. Default: "
    "the recorded camera."
)
@appearance_option("Default: the scenes as they were compiled.")
@count_option("--videos", 12, "Maximum number of videos of failed episodes for each policy.", least=0)
@click.option("--tables", "all_tables", is_flag=True, help="Also print tables by scene, tier, category and template.")
@renderer_option
@json_option
def run(
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    tls: Path | None,
    out: Path | None,
    videos: int,
    all_tables: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Evaluate policies in closed loop on the episodes of a dataset.

    \b
    POLICY is one of
      built-in:  expert, planner, random, stop, bc:DIR,
                 replay (recorded actions of the same episode),
                 playback (recorded actions of another episode)
      a class:   package.module:Class (see docs/evaluation/README.md)
      a server:  ws://HOST:PORT (openpi's protocol: WebSocket and msgpack)

    Writes episodes.parquet, results.json and index.html to --out. The same command continues an interrupted evaluation.
    """
    configure_logs()
    access = _network_access(listen, connect, tls, out, options["workers"])
    campaign = make_campaign(EvalOptions(**options), drives_here=access is None)
    with ExitStack() as stack:
        folder = out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="eval-")))
        store = stack.enter_context(open_store(campaign, folder))
        if not _drive(campaign, store, access):
            kept = "run the same command again to continue" if out else "the results were not stored: use -o DIR"
            click.echo(f"interrupted: {kept}", err=True)
            return 130
        evaluation = published(campaign, store, videos) if out else evaluation_of(campaign, store)
        print_result(evaluation, as_json, partial(print_evaluation, all_tables=all_tables))
        if out:
            click.echo(f"results in {out}: results.json, episodes.parquet, index.html", err=True)
            _print_repeat_command(evaluation, store)
    return _exit_code_of(evaluation)


def _print_repeat_command(evaluation: Evaluation, store: Store) -> None:
    folders = [shlex.quote(str(store.folder_of(policy.policy))) for policy in evaluation.policies if policy.faults]
    if folders:
        again = f"run `rm -r {' '.join(folders)}` and the same command again"
        click.echo(f"note: episodes with policy faults are kept; to repeat a corrected policy, {again}", err=True)


def _exit_code_of(evaluation: Evaluation) -> int:
    """Returns the exit code: 1 if a policy had a fault in every episode, because it was then not evaluated."""
    lost = [policy.policy for policy in evaluation.policies if policy.only_failed]
    for name in lost:
        click.echo(f"error: policy {name} had a fault in every episode, so it was not evaluated", err=True)
    return 1 if lost else 0


def _network_access(
    listen: tuple[str, ...], connect: tuple[str, ...], tls: Path | None, out: Path | None, workers: int | None
) -> FleetAccess | None:
    """Returns how workers are reached; `None` if this machine runs the episodes."""
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


def _drive(campaign: Campaign, store: Store, access: FleetAccess | None) -> bool:
    with stop_on_signals() as (stop, _), pace_bars(campaign) as tell:
        if access is None:
            return run_campaign(campaign, store, stop, tell)
        return run_fleet(campaign, Dataset(campaign.root).meta.plan, store, access, stop, tell)


command.set_default(run)
command.add_command(specs_command)
command.add_command(compare_command)
