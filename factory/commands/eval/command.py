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
from factory.commands.common.admission import choose_listening
from factory.commands.common.output import print_result
from factory.commands.eval.campaign import EvalOptions, make_campaign, open_store, pace_bars, published
from factory.commands.eval.tables import print_evaluation
from factory.dataset.reader import Dataset
from factory.eval.process.local_campaign import run_campaign
from factory.eval.remote.fleet import FleetAccess, run_fleet
from factory.eval.results.publish import evaluation_of
from factory.eval.results.score import Evaluation
from factory.eval.results.store import Store
from factory.eval.specs.campaign import Campaign
from factory.support.listen import require_loopback, require_tls_endpoints
from factory.support.logs import configure_logs
from schemas.errors import UsageError
from workers.client.stopping import stop_on_signals


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
    """Executes `factory eval`."""
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
        click.echo(f"note: results with policy faults are kept; to evaluate a corrected policy, {again}", err=True)


def _exit_code_of(evaluation: Evaluation) -> int:
    """Returns the exit code: 1 if a policy had a fault in every episode, because such a policy was not evaluated."""
    lost = [policy.policy for policy in evaluation.policies if policy.only_failed]
    for name in lost:
        click.echo(f"error: policy {name} had a fault in every episode, so it was not evaluated", err=True)
    return 1 if lost else 0


def _network_access(
    listen: tuple[str, ...], connect: tuple[str, ...], tls: Path | None, out: Path | None, workers: int | None
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
