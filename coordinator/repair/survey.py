"""What is wrong between archive, ledger and plan, and what would put it right. Reads and hashes; changes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Row, select
from sqlalchemy.engine import Connection

from coordinator.archive.contract import EPISODES, index_of_file
from coordinator.archive.object_path import ObjectPath
from coordinator.archive.place import Place, at_hand, children, digest_of
from coordinator.ledger.keepers import all_keepers
from coordinator.ledger.repair import current_job
from coordinator.ledger.states import State
from coordinator.ledger.tables import episodes
from coordinator.plan.catalog import Catalog
from coordinator.plan.draw import PlannedJob, expand, redraw, to_job
from coordinator.puller import Checker
from coordinator.summary import EpisodeSummary
from schemas.bundle import BundleReader
from schemas.errors import InvalidBundle
from schemas.job import Job, episode_id
from schemas.plan import Plan

__all__ = ["Survey", "survey_archive"]

Tell = Callable[[int, int], None]


@dataclass
class Survey:
    """Findings by what is to be done about them; `why` is in words."""

    whole: int = 0
    """Episodes on disk that the ledger owns, bit for bit."""
    adopt: list[EpisodeSummary] = field(default_factory=list)
    quarantine: list[tuple[Place, str]] = field(default_factory=list)
    requeue: list[tuple[int, str]] = field(default_factory=list)


def survey_archive(
    root: Place, plan: Plan, catalog: Catalog, ledger: Connection | None, checker: Checker, tell: Tell
) -> Survey:
    """Compares every file of a dataset with the ledger, and what the ledger does not own with the plan.

    Args:
        root: of the dataset.
        plan: of the run.
        catalog: of its scenes.
        ledger: open for reading; `None` when it is lost.
        checker: validates what might be adopted.
        tell: told how many files of how many are done.
    """
    result = Survey()
    owned = _owned(ledger)
    away = all_keepers(ledger) if ledger is not None else {}
    files, foreign = _listing(root)
    result.quarantine += [(path, "no episode by its name") for path in foreign]
    draws = _Draws(plan, catalog)
    for done, (index, path) in enumerate(files.items(), 1):
        if index in owned:
            _compare(index, path, owned[index], result, is_kept=index in away)
        else:
            _judge(path, index, draws, ledger, checker, result)
        tell(done, len(files))
    result.requeue += [(index, "its file is gone") for index in sorted(owned.keys() - files.keys() - away.keys())]
    return result


class _Draws:
    """The draws that the plan gives an episode, worked out when asked for."""

    def __init__(self, plan: Plan, catalog: Catalog) -> None:
        self.plan, self.catalog = plan, catalog
        self._first: dict[int, PlannedJob] | None = None

    def job(self, index: int, draw: int, attempt: int) -> Job | None:
        """Returns the job of an attempt; `None` when the plan has no such draw."""
        if self._first is None:
            self._first = {planned.index: planned for planned in expand(self.plan, self.catalog)}
        planned = self._first.get(index)
        if planned is None or not 0 <= draw < self.plan.budget.draws:
            return None
        for _ in range(draw):
            planned = redraw(self.plan, self.catalog, planned)
        return to_job(self.plan, self.catalog, planned, attempt)


def _owned(ledger: Connection | None) -> Mapping[int, Row[Any]]:
    if ledger is None:
        return {}
    rows: Any = ledger.execute(select(episodes.c.idx, episodes.c.size, episodes.c.sha256))
    return {row.idx: row for row in rows}


def _listing(root: Place) -> tuple[dict[int, Place], list[Place]]:
    folder = root / EPISODES
    paths = sorted(folder.walk()) if isinstance(folder, ObjectPath) else children(folder)
    found = {path: index_of_file(path.name) if _is_episode(path, folder) else None for path in paths}
    files = {index: path for path, index in found.items() if index is not None}
    return dict(sorted(files.items())), [path for path, index in found.items() if index is None]


def _is_episode(path: Place, folder: Place) -> bool:
    return path.parent == folder and path.is_file() and not path.is_symlink()


def _compare(index: int, path: Place, row: Row[Any], result: Survey, *, is_kept: bool) -> None:
    size = path.stat().st_size
    reason = f"{size} bytes, the ledger says {row.size}" if size != row.size else _digest_finding(path, row.sha256)
    if reason:
        result.quarantine.append((path, reason))
        if not is_kept:  # else a gateway has it still
            result.requeue.append((index, reason))
    else:
        result.whole += 1


def _digest_finding(path: Place, sha256: str) -> str:
    try:
        found = digest_of(path)
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    return "" if found == sha256 else f"SHA-256 {found}, the ledger says {sha256}"


def _judge(path: Place, index: int, draws: _Draws, ledger: Connection | None, checker: Checker, result: Survey) -> None:
    verdict = _verdict(path, index, draws, ledger, checker)
    if isinstance(verdict, str):
        result.quarantine.append((path, verdict))
    else:
        result.adopt.append(verdict)


def _verdict(
    path: Place, index: int, draws: _Draws, ledger: Connection | None, checker: Checker
) -> EpisodeSummary | str:
    """Returns the row that a file nobody owns deserves, or why it deserves none."""
    try:
        with at_hand(path) as local:
            with local.open("rb") as file, BundleReader(file) as bundle:
                said = bundle.meta.job
            job = draws.job(index, said.draw, said.attempt)
            if job is None:
                return f"the plan has no draw {said.draw} of {episode_id(index)}"
            obstacle = next(_obstacles(ledger, index, said), "")
            if obstacle:
                return obstacle
            return checker.check(local, job, draws.catalog[job.scene].info.target(job.target_id))
    except InvalidBundle as error:
        return str(error)
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _obstacles(ledger: Connection | None, index: int, said: Job) -> Iterator[str]:
    row = current_job(ledger, index) if ledger is not None else None
    if ledger is None:
        return
    if row is None:
        yield "the plan has no such episode"
    elif row.state == State.ARCHIVED:
        yield "the ledger owns another file"
    elif (row.draw, row.attempt) > (said.draw, said.attempt):
        yield f"the ledger has seen draw {said.draw}, attempt {said.attempt} fail"
