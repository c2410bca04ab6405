"""`factory eval`: drive policies closed-loop over a dataset's splits; prints every measure with its interval."""

from __future__ import annotations

import os
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import cast

import click
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from factory.cli.eval_compare import command as compare_command
from factory.cli.eval_options import SplitList, splits_of
from factory.cli.eval_specs import command as specs_command
from factory.cli.eval_tables import print_evaluation
from factory.cli.output import json_option, print_json, stderr
from factory.dataset import Dataset
from factory.eval.ablation import ABLATIONS
from factory.eval.campaign import Campaign
from factory.eval.from_dataset import specs_of_dataset
from factory.eval.message import Setup
from factory.eval.policies import check_name
from factory.eval.publish import publish
from factory.eval.result import Variant
from factory.eval.run import Pace, run_campaign
from factory.eval.spec import SpecSet
from factory.eval.spec_file import read_specs
from factory.eval.store import Manifest, Store
from factory.logs import configure_logs
from schemas.errors import UsageError
from schemas.terms import RendererKind, Split
from workers.stopping import stop_on_signals

__all__ = ["command"]


@click.group("eval", invoke_without_command=True)
@click.option("--data", "root", type=click.Path(path_type=Path), metavar="DIR", help="The dataset: its scenes, splits.")
@click.option("--split", "splits", type=SplitList(), help="S[,S...] or `all`; default: the test splits.")
@click.option("--policy", "policies", multiple=True, metavar="P", help="Repeat for several; see below.")
@click.option("--specs", "specs_path", type=click.Path(path_type=Path), metavar="FILE", help="Of `factory eval specs`.")
@click.option("--ablate-language", is_flag=True, help="Also with shuffled, wrong-category and empty instructions.")
@click.option("--episodes", type=click.IntRange(1), metavar="N", help="Only N, spread evenly over the set.")
@click.option("--workers", type=click.IntRange(1, 256), help="Driving processes; default: one a core.")
@click.option("-o", "--out", type=click.Path(path_type=Path), metavar="OUT", help="Where results are kept; resumes.")
@click.option("--act-timeout", type=click.FloatRange(0.01), default=10.0, show_default=True, help="Seconds an answer.")
@click.option("--load-timeout", type=click.FloatRange(0.1), default=300.0, show_default=True, help="Of the first one.")
@click.option("--pose", "with_pose", is_flag=True, help="Give policies the pose in the frame of the start.")
@click.option("--videos", type=click.IntRange(0), default=12, show_default=True, help="Failures shown a policy.")
@click.option("--tables", "all_tables", is_flag=True, help="Print by scene, tier, category and template too.")
@click.option("--renderer", type=click.Choice(["auto", "gl", "tiny"]), default="auto", show_default=True)
@json_option
@click.pass_context
def command(
    context: click.Context,
    root: Path | None,
    splits: tuple[Split, ...] | None,
    policies: tuple[str, ...],
    specs_path: Path | None,
    ablate_language: bool,
    episodes: int | None,
    workers: int | None,
    out: Path | None,
    act_timeout: float,
    load_timeout: float,
    with_pose: bool,
    videos: int,
    all_tables: bool,
    renderer: str,
    as_json: bool,
) -> int | None:
    """Evaluate policies closed-loop on episodes of a dataset.

    \b
    Built in:   expert, planner, random, stop, replay, playback
    Yours:      package.module:Class   (reset, act; see docs/evaluation/README.md)
    A server:   ws://HOST:PORT         (openpi's websocket and msgpack)

    With -o everything is kept: episodes.parquet, results.json, index.html. The same command goes on where it was.
    """
    if context.invoked_subcommand is not None:
        return None
    configure_logs()
    if root is None or not policies:
        raise UsageError("give the dataset and a policy: factory eval --data DIR --policy expert")
    for name in policies:
        check_name(name)
    dataset = Dataset(root)
    variants = (Variant.ORIGINAL, *ABLATIONS) if ablate_language else (Variant.ORIGINAL,)
    specs = _specs(dataset, specs_path, splits, episodes)
    setup = Setup(
        settings=specs.settings,
        renderer=cast(RendererKind, renderer),
        act_timeout_s=act_timeout,
        load_timeout_s=load_timeout,
    )
    processes = min(workers or os.cpu_count() or 1, len(specs.specs))
    campaign = Campaign(specs, root, tuple(dict.fromkeys(policies)), variants, setup, processes, with_pose)
    with ExitStack() as stack:
        folder = out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="eval-")))
        manifest = Manifest(
            run=dataset.meta.run, specs_digest=specs.digest, with_pose=with_pose, act_timeout_s=act_timeout
        )
        store = stack.enter_context(Store(folder, specs, manifest))
        if not _drive(campaign, store):
            kept = f"run the same command to go on; {out} holds what is done" if out else "give -o to keep what is done"
            click.echo(f"interrupted: {kept}", err=True)
            return 130
        with Progress(*_columns(), console=stderr, transient=True) as bar:
            task = bar.add_task("drawing failures", total=None)
            evaluation = publish(
                campaign, store, videos if out else 0, lambda done, of: bar.update(task, completed=done, total=of)
            )
        if as_json:
            print_json(evaluation.model_dump(mode="json"))
        else:
            print_evaluation(evaluation, all_tables)
        if out:
            click.echo(f"kept in {out}: results.json, episodes.parquet, index.html", err=True)
    return 0


def _specs(dataset: Dataset, path: Path | None, splits: tuple[Split, ...] | None, episodes: int | None) -> SpecSet:
    """The specs of a file, or made of the dataset."""
    if path is not None:
        return read_specs(path).only(frozenset(splits) if splits else None, episodes)
    chosen = splits_of(dataset, splits)
    with Progress(*_columns(), console=stderr, transient=True) as bar:
        task = bar.add_task("reading starts", total=None)
        return specs_of_dataset(dataset, chosen, lambda done, of: bar.update(task, completed=done, total=of), episodes)


def _drive(campaign: Campaign, store: Store) -> bool:
    with (
        stop_on_signals() as (stop, _),
        Progress(*_columns(), TextColumn("{task.fields[note]}"), console=stderr) as bar,
    ):
        tasks = {name: bar.add_task(name, total=None, note="") for name in campaign.policies}

        def tell(pace: Pace) -> None:
            note = f"{pace.successes} succeeded"
            bar.update(tasks[pace.policy], completed=pace.done, total=pace.total, note=note)

        return run_campaign(campaign, store, stop, tell)


def _columns() -> tuple[TextColumn | BarColumn | MofNCompleteColumn | TimeElapsedColumn | TimeRemainingColumn, ...]:
    return (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )


command.add_command(specs_command)
command.add_command(compare_command)
