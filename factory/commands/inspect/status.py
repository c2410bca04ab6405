"""`factory status`: shows the progress of a run, read from its ledger or from a running coordinator."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Group
from rich.live import Live
from rich.text import Text

from coordinator.protocol.tls import read_credentials
from coordinator.validation.sandbox import SECCOMP
from factory.commands.common.output import FittedTable, print_json, stdout
from factory.commands.inspect.shard_status import draw_shards, shards_as_json
from factory.dataset.site import Site, site_of
from factory.runs.ledger import progress_of
from factory.support.listen import require_endpoints
from factory.support.text import format_duration
from schemas.dataset.run_shard import find_shards
from schemas.errors import TransientError, UsageError, WorldError
from schemas.protocol.status import HostStatus, Progress, WorkerStatus
from schemas.storage.dataset_files import LEDGER_FILE, is_dataset, is_submitted_run
from schemas.terms import BUILTIN_CATEGORIES

_PAUSE_S = 1.0
_PATIENCE_S = 60.0
"""Time without an answer after which `--watch` gives up, seconds; a restart of a coordinator takes a few seconds."""
_FIRST = max(map(len, BUILTIN_CATEGORIES))
"""Minimum width of the first column of each table, characters. It aligns the numbers of all tables."""
_REASON_CHARS = 200
_COLUMNS = ("pending", "leased", "submitted", "archived", "failed", "cancelled")
_ALWAYS = ("pending", "leased", "archived")
"""States whose columns are always shown; the columns of other states are shown if a job has the state."""


def execute(
    site: Site | None, connect: tuple[str, ...], ledger: str | None, watch: bool, tls: Path | None, as_json: bool
) -> None:
    """Executes `factory status`."""
    site = None if site is None else _inside(site)
    shards = list(find_shards(site.place)) if site is not None and not connect and not _has_ledger(site, ledger) else []
    if shards:
        print_json(shards_as_json(shards)) if as_json else stdout.print(draw_shards(shards), soft_wrap=False)
        return
    source = _source(site, connect, ledger, tls)
    if as_json:
        print_json(source().model_dump(mode="json"))
    elif watch:
        watch_progress(source)
    else:
        stdout.print(draw_progress(source()), soft_wrap=False)


def _inside(site: Site) -> Site:
    """Returns the location of the dataset or the shards if `site` is the folder of a submitted run, else `site`."""
    run = site.place
    if not isinstance(run, Path) or not is_submitted_run(run):
        return site
    if is_dataset(run / "dataset"):
        return site_of(run / "dataset")
    if not any(find_shards(run / "shards")):
        raise WorldError(
            f"no task of {run} has written its state yet; a task writes it some seconds after its start: see "
            f"`squeue` and the logs in {run / 'slurm'}"
        )
    return site_of(run / "shards")


def _has_ledger(site: Site, ledger: str | None) -> bool:
    return ledger is not None or (site.state_dir / LEDGER_FILE).is_file()


def _source(
    site: Site | None, connect: tuple[str, ...], ledger: str | None, tls: Path | None
) -> Callable[[], Progress]:
    if connect:
        from coordinator.protocol.ask import ask_progress

        require_endpoints(connect, with_tls=tls is not None)
        if tls is None:
            return lambda: ask_progress(connect)
        files, name = read_credentials(tls)
        return lambda: ask_progress(connect, name, files)
    if site is None:
        raise UsageError("the dataset is missing: give DIR or URL, or --connect ENDPOINT")
    return lambda: progress_of(site, ledger)


def watch_progress(source: Callable[[], Progress], pause_s: float = _PAUSE_S, patience_s: float = _PATIENCE_S) -> None:
    """Shows the progress of a run until it has finished; tolerates a restart of its coordinator.

    Args:
        source: returns the progress; raises `TransientError` if the coordinator does not answer.
        pause_s: time between two requests, seconds.
        patience_s: time without an answer after which the error is raised, seconds.
    """
    progress = source()
    heard = time.monotonic()
    with Live(draw_progress(progress), console=stdout, auto_refresh=False) as live:
        while not progress.finished:
            time.sleep(pause_s)
            try:
                progress = source()
            except TransientError:
                silence_s = time.monotonic() - heard
                if silence_s > patience_s:
                    raise
                remark = Text(f"no answer for {format_duration(silence_s)}; retrying", style="yellow")
                live.update(Group(draw_progress(progress), remark), refresh=True)
            else:
                heard = time.monotonic()
                live.update(draw_progress(progress), refresh=True)


def draw_progress(progress: Progress) -> Group:
    """Returns the progress of a run as text and tables."""
    done = progress.jobs.get("archived", 0)
    rate = "-" if progress.episodes_per_hour is None else f"{progress.episodes_per_hour:.0f}/h"
    left = "finished" if progress.finished else f"ETA {format_duration(progress.eta_s)}"
    head = f"{progress.run}: {done} of {progress.planned} episodes archived, {rate}, {left}"
    tries = ", ".join(f"{count} {name}" for name, count in progress.failures.items()) or "none"
    is_waiting = progress.paused and not progress.finished
    paused = [Text("paused; continue with `factory jobs resume DIR`", style="yellow")] if is_waiting else []
    back = f"; returned jobs: {progress.given_back}" if progress.given_back else ""
    packed = [Text(f"shards of packed episodes: {progress.shards}")] if progress.shards else []
    layouts = [Text(progress.built_layouts)] if progress.layouts else []
    foot = f"failed attempts: {tries}{back}; redrawn targets: {progress.redrawn}"
    kept = ", ".join(f"{count} at {gateway}" for gateway, count in progress.by_gateway.items())
    away = [Text(f"stored at gateways: {kept}; copy them into one dataset with `factory gather`")] if kept else []
    groups = {"scene": progress.by_scene, "tier": progress.by_tier, "split": progress.by_split}
    states = [state for state in _COLUMNS if state in _ALWAYS or progress.jobs.get(state)]
    tables = [_group_table(name, rows, states) for name, rows in groups.items()]
    hosts = map(_describe_host, progress.hosts)
    sandbox = _describe_sandbox(progress.sandbox)
    top = (Text(head, style="bold"), *paused, *layouts, *away, *packed)
    return Group(*top, *tables, _workers(progress), *hosts, *sandbox, Text(foot))


def _describe_sandbox(layers: tuple[str, ...]) -> list[Text]:
    """Returns the sandbox layers of the validating processes, and a remedy if seccomp is missing."""
    if not layers or SECCOMP in layers:
        return [Text(f"validator sandbox: {', '.join(layers)}")] if layers else []
    remedy = "install the extra `sandbox` and the system's libseccomp2 to add seccomp"
    return [Text(f"validator sandbox: {', '.join(layers)} only; {remedy}", style="yellow")]


def _describe_host(host: HostStatus) -> Text:
    """Returns why a host is barred or limited to one job at a time; for a barred host, also what to do."""
    why = f"{host.strikes} failures, last: {' '.join(host.reason[:_REASON_CHARS].split())}"
    if host.barred_at is None:
        return Text(f"host {host.host} is limited to one job at a time, with pauses: {why}", style="yellow")
    since = f"{host.barred_at:%H:%M:%S}"
    remedy = f"repair the host, then run `factory jobs release DIR {host.host}`"
    return Text(f"host {host.host} is barred since {since}: {why}; {remedy}", style="bold red")


def _group_table(name: str, rows: dict[str, dict[str, int]], states: list[str]) -> FittedTable:
    body = [(key, *(counts.get(state, 0) for state in states)) for key, counts in rows.items()]
    return FittedTable("", (name, *states), body, _FIRST)


def _workers(progress: Progress) -> FittedTable:
    barred = {host.host for host in progress.hosts if host.barred_at is not None and not progress.finished}
    body = [
        (w.sid, w.slots, w.leased, w.archived, "barred" if w.host in barred else _state_of(w, progress.finished))
        for w in progress.workers
    ]
    return FittedTable("", ("worker", "slots", "leased", "archived", "state"), body, _FIRST)


def _state_of(worker: WorkerStatus, is_finished: bool) -> str:
    """Returns the displayed state of a worker; workers of a finished run are shown as `left`."""
    if is_finished:
        return "left"
    return "alive" if worker.alive else f"silent since {worker.last_beat:%H:%M:%S}"
