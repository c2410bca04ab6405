"""Farm page: progress, cells, workers, failures over time, events and disk; kept current by server-sent events."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime

import pyarrow as pa
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from coordinator.ledger.reading.farm import FarmReading, RunningJob
from factory.html import render
from factory.runs.progress_text import why_stopped
from factory.support.text import format_bytes, format_duration, format_time
from factory.web.charts import draw_columns
from factory.web.context import FarmView, context_of, page
from factory.web.live import LiveFeed
from factory.web.recent import Recent
from factory.web.workspace import Farm, Workspace
from schemas.errors import FactoryError
from schemas.job import episode_id
from schemas.protocol.messages import HostMemory
from schemas.protocol.status import Progress, WorkerStatus
from schemas.terms import family_of

_MAPS = 8
"""Maximum number of scenes for which the page draws a map of failures."""
_STATES = ("archived", "submitted", "leased", "pending", "failed", "cancelled")


@dataclass(frozen=True)
class QuotaRow:
    """Row of the matrix of cells."""

    scene: str
    tier: str
    split: str
    quota: int
    """Number of planned episodes."""
    counts: tuple[int, ...]
    """Number of episodes in each state of `_STATES`."""


@dataclass(frozen=True)
class WorkerRow:
    """Row of the table of workers."""

    sid: str
    host: str
    slots: int
    archived: int
    jobs: str
    """Jobs of the worker with their steps."""
    frames_per_s: str
    version: str
    state: str
    last_beat: str
    memory: str
    """Used and total memory of its host."""


def routes(view: Recent[FarmView]) -> list[Route]:
    """Returns the routes of the page.

    Args:
        view: result of `read_view`, shared by all tabs and requests.
    """
    return [Route("/farm", show), Route("/live", LiveFeed(lambda: view.get().fragment, forget=view.forget))]


def show(request: Request) -> Response:
    view = context_of(request).farm.get()
    return page(request, "farm", "Farm", fragment=view.fragment, failed_scenes=view.failed_scenes)


def read_view(workspace: Workspace) -> FarmView:
    """Returns the current content of the page; if the ledger cannot be read, the page shows the reason."""
    try:
        farm = workspace.farm()
    except FactoryError as error:
        disk, tables = _disk(workspace), _tables(workspace)
        text = render("web/no_farm.html", base=workspace.base, trouble=str(error), tables=tables, disk=disk)
        return FarmView(text, [], is_over=True)
    return FarmView(_draw(workspace, farm), list(farm.failed.items())[:_MAPS], farm.progress.finished)


def _draw(workspace: Workspace, farm: Farm) -> str:
    progress, reading = farm.progress, farm.reading
    done = progress.jobs.get("archived", 0)
    return render(
        "web/farm_fragment.html",
        base=workspace.base,
        progress=progress,
        done=done,
        tiles=_tiles(farm),
        states=_STATES,
        cells=list(_cells(reading)),
        workers=[_worker(worker, farm) for worker in progress.workers],
        hosts=progress.hosts,
        failures=progress.failures,
        chart=_chart(reading),
        events=[
            (format_time(event.at, farm.at), event.scene if event.is_build else episode_id(event.index), event)
            for event in reading.events
        ],
        unbuilt=progress.planned - sum(sum(counts.values()) for counts in reading.cells.values()),
        failed_scenes=list(farm.failed.items())[:_MAPS],
        scenes=_scenes(workspace, farm),
        gateways=progress.by_gateway,
        disk=_disk(workspace),
        ledger=f"format {farm.info.format}, {workspace.ledger_health()}",
        paused=progress.paused,
        stopped=why_stopped(progress),
        requests=[(format_time(one.time, farm.at), one.action, one.changed) for one in reading.requests],
    )


def _tiles(farm: Farm) -> list[tuple[str, str, str]]:
    progress = farm.progress
    done, failed = progress.jobs.get("archived", 0), progress.jobs.get("failed", 0)
    alive = [worker for worker in progress.workers if worker.alive]
    rate = "–" if progress.episodes_per_hour is None else f"{progress.episodes_per_hour:.0f}/h"
    frames = sum(farm.reading.frames_per_s.values())
    return [
        ("episodes", f"{done}", f"of {progress.planned}"),
        ("rate", rate, "over ten minutes"),
        ("remaining", "finished" if progress.finished else format_duration(progress.eta_s), ""),
        ("workers", f"{len(alive)}", f"{sum(worker.slots for worker in alive)} simulations"),
        ("frames", f"{frames:.0f}/s", "over ten minutes"),
        ("failed", f"{failed}", f"{sum(progress.failures.values())} failed attempts"),
    ]


def _cells(reading: FarmReading) -> Iterator[QuotaRow]:
    for (scene, tier, split), counts in reading.cells.items():
        yield QuotaRow(
            scene,
            tier,
            split=split,
            quota=sum(counts.values()),
            counts=tuple(counts.get(state, 0) for state in _STATES),
        )


def _worker(worker: WorkerStatus, farm: Farm) -> WorkerRow:
    jobs = farm.reading.running.get(worker.sid, ())
    rate = farm.reading.frames_per_s.get(worker.sid)
    return WorkerRow(
        sid=worker.sid,
        host=worker.host,
        slots=worker.slots,
        archived=worker.archived,
        jobs=", ".join(map(_job, jobs)) or "–",
        frames_per_s="–" if rate is None else f"{rate:.1f}",
        version=farm.reading.versions.get(worker.sid, "") or "–",
        state=_state_of(worker, farm.progress),
        last_beat=format_time(worker.last_beat, farm.at),
        memory=_memory(farm.reading.memory.get(worker.host)),
    )


def _job(job: RunningJob) -> str:
    return f"builds {job.scene}" if job.is_build else f"{episode_id(job.index)} step {job.step}"


def _memory(memory: HostMemory | None) -> str:
    return "–" if memory is None else f"{format_bytes(memory.used_bytes)} of {format_bytes(memory.total_bytes)}"


def _state_of(worker: WorkerStatus, progress: Progress) -> str:
    if any(host.host == worker.host and host.barred_at is not None for host in progress.hosts):
        return "barred"
    return "left" if progress.finished else "alive" if worker.alive else "silent"


def _chart(reading: FarmReading) -> str:
    if not reading.history:
        return ""
    first, last = reading.history[0].begin, reading.history[-1].end
    columns = [{"archived": one.archived, **one.failures} for one in reading.history]
    return draw_columns("Attempts that ended, over time", columns, _clock(first), _clock(last))


def _clock(at: datetime) -> str:
    return f"{at:%d %b %H:%M:%S} UTC"


def _tables(workspace: Workspace) -> list[tuple[str, str, int]]:
    """Returns scene, split and number of episodes according to the tables of a dataset without ledger."""
    try:
        dataset = workspace.dataset()
        columns = {name: dataset.column(name).cast(pa.string()) for name in ("scene", "split")}
    except FactoryError:
        return []
    counts = pa.table(columns).group_by(["scene", "split"]).aggregate([([], "count_all")]).to_pylist()
    return sorted((row["scene"], row["split"], row["count_all"]) for row in counts)


def _scenes(workspace: Workspace, farm: Farm) -> list[tuple[str, int, int]]:
    """Returns for each family or single scene of the plan the number of scenes, and how many have a stored package."""
    stored = workspace.packaged_scenes()
    planned, built = Counter[str](), Counter[str]()
    for part in farm.info.plan.parts:
        planned[family_of(part.name)] += 1
        built[family_of(part.name)] += part.name in stored
    return [(family, count, built[family]) for family, count in planned.items()]


def _disk(workspace: Workspace) -> str:
    if not workspace.site.state_dir.is_dir():
        return "unknown"
    usage = shutil.disk_usage(workspace.site.state_dir)
    return f"{format_bytes(usage.free)} of {format_bytes(usage.total)} free"
