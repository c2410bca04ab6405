"""`factory correct`: a policy drives, and the planner's action is recorded at every pose that it visits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coordinator.defaults import usable_cores
from factory.cli.options import (
    count_option,
    dataset_argument,
    json_option,
    number_option,
    policy_limit_options,
    renderer_option,
    verbose_option,
    workers_option,
    write_option,
)
from schemas.errors import UsageError, WorldError
from schemas.support.shell import quoted

if TYPE_CHECKING:
    from factory.dataset.site import Site
    from schemas.plan import Plan
    from schemas.protocol.status import Progress
    from schemas.terms import RendererKind

_FAILURES = 24
"""Number of failures of the policy without any episode after which a round ends."""


@click.command("correct")
@dataset_argument
@click.option(
    "--policy", required=True, metavar="POLICY", help="Policy to correct: bc:OUT, module:Class or ws://HOST:PORT."
)
@write_option("DIR", "Directory of the corrections, a dataset of states. The same command continues it.", required=True)
@count_option("--episodes", None, "Number of episodes. Default: half of the training episodes of DIR.")
@count_option("--round", 1, "Number of the round; each round has other starts.", most=1000)
@number_option(
    "SHARE",
    "--expert-share",
    0.0,
    "Share of the time in which the planner drives in any case (beta of DAgger).",
    least=0.0,
    most=1.0,
)
@number_option(
    "SHARE", "--disturbed-share", 0.25, "Share of episodes that begin with random motion.", least=0.0, most=1.0
)
@workers_option("Number of simulation processes")
@renderer_option
@policy_limit_options
@json_option
@verbose_option
def command(
    root: Path,
    policy: str,
    out: Path,
    episodes: int | None,
    round: int,  # noqa: A002 - the name of the option
    expert_share: float,
    disturbed_share: float,
    workers: int | None,
    renderer: RendererKind,
    act_timeout: float,
    load_timeout: float,
    as_json: bool,
    verbose: bool,
) -> int:
    """Record the planner's corrections of a policy that drives.

    The policy drives on the training scenes of DIR, from new starts. Every tenth of a second, the planner's action at
    that pose is recorded as a label; the planner takes over before a collision and after a stop in the wrong place, and
    ends every episode at its target. `factory train bc DIR --correction OUT` trains on both. Exits with 1 if episodes
    are missing.
    """
    from factory.correct.driver import check_corrected
    from factory.correct.round import correction_plan, describe_policy
    from factory.dataset.reader import Dataset
    from factory.dataset.site import site_of
    from factory.support.logs import configure_logs
    from schemas.config import CorrectionConfig
    from schemas.support.extras import require_package

    configure_logs(verbose)
    require_package("pybullet", "`factory correct`")
    check_corrected(policy)
    dataset, site = Dataset(root), site_of(out)
    trained = len(dataset.filter(split="train_id"))
    correction = CorrectionConfig(
        policy=policy,
        made_from=describe_policy(policy, act_timeout, load_timeout),
        round=round,
        expert_share=expert_share,
        disturbed_share=disturbed_share,
        target_in_view=dataset.meta.plan.demonstration.target_in_view,
    )
    plan = correction_plan(dataset.meta.plan, correction, episodes or max(1, trained // 2))
    _require_same_round(site, plan)
    limits = ("--policy", policy, "--act-timeout", str(act_timeout), "--load-timeout", str(load_timeout))
    again = f"factory correct {quoted(root)} --policy {quoted(policy)} -o {quoted(out)}"
    processes = workers or usable_cores()
    progress = _run(plan, site, root, workers=processes, renderer=renderer, limits=limits, again=again, verbose=verbose)
    if progress is None or not progress.finished:
        click.echo(f"interrupted; continue with the same command: {again}", err=True)
        return 130
    return _print_end(site, progress, root, as_json)


def _require_same_round(site: Site, plan: Plan) -> None:
    """Raises an error if the directory has corrections of another policy or other options.

    Raises:
        UsageError: it has; the message names both.
    """
    from coordinator.ledger.opening import require_plan
    from factory.runs.ledger import plan_of

    recorded = plan_of(site)
    if recorded is None:
        return
    former, now = recorded.correction, plan.correction
    if former is None:
        raise UsageError(f"{site} contains the run {recorded.run}, which has no corrections: give another -o")
    assert now is not None
    if former.made_from != now.made_from:
        raise UsageError(
            f"{site} has corrections of policy {former.policy} {former.made_from[:12]}, but {now.policy} is now "
            f"{now.made_from[:12]}: give another -o, and --round {former.round + 1} for new starts"
        )
    require_plan(recorded, plan)


def _run(
    plan: Plan,
    site: Site,
    source: Path,
    workers: int,
    renderer: RendererKind,
    limits: tuple[str, ...],
    again: str,
    *,
    verbose: bool,
) -> Progress | None:
    from coordinator.settings import CoordinatorSettings
    from factory.runs.local import LocalRun, require_renderer, run_locally
    from factory.runs.start import open_scenes
    from factory.runs.summary import RunBar
    from schemas.storage.dataset_files import SCENES
    from workers.client.stopping import stop_on_signals

    require_renderer(renderer)
    with stop_on_signals() as (stop, _):
        catalog = open_scenes(plan, site, "skip", processes=workers, stop=stop, packages=source / SCENES)
        if stop.is_set():
            return None
        run = LocalRun(
            plan=plan,
            catalog=catalog,
            root=site.state_dir,
            workers=workers,
            renderer=renderer,
            verbose=verbose,
            store=site.store,
            worker_options=limits,
            continued_by=again,
        )
        with RunBar(plan) as bar:

            def tell(progress: Progress) -> None:
                bar.show(progress)
                _require_a_policy_that_drives(progress)

            return run_locally(run, CoordinatorSettings(), stop, tell)


def _require_a_policy_that_drives(progress: Progress) -> None:
    """Ends a round in which the policy fails in every episode.

    Raises:
        WorldError: it does.
    """
    failed = progress.attempts.get("policy", 0)
    if failed >= _FAILURES and not progress.jobs.get("archived", 0):
        raise WorldError(
            f"the policy failed in {failed} attempts and drove no episode to its end; `factory jobs list` with the "
            "directory of the corrections shows why"
        )


def _print_end(site: Site, progress: Progress, source: Path, as_json: bool) -> int:
    from factory.correct.round import describe_corrections
    from factory.runs.summary import print_missing, summarise
    from factory.support.terminal import print_result, print_text

    summary: dict[str, Any] = summarise(site.place, progress) | describe_corrections(site.place)
    summary["next"] = f"factory train bc {quoted(source)} --correction {quoted(site.place)} -o OUT"

    def show(it: dict[str, Any]) -> None:
        print_text(f"corrections {it['dataset']}: {it['episodes']} of {it['planned']} episodes, {it['steps']} steps")
        print_text(f"digest  {it['digest']}")
        by = ", ".join(f"{100 * share:.0f} % {name}" for name, share in it["driven_by"].items())
        print_text(f"driven by: {by}; {it['labels']} labels, {it['takeovers']} takeovers")
        tries = ", ".join(f"{count} {outcome}" for outcome, count in it["attempts"].items())
        print_text(f"attempts: {tries}")
        print_text(f"next:    {it['next']}")

    print_result(summary, as_json, show)
    print_missing(site, progress)
    return 1 if progress.missing else 0
