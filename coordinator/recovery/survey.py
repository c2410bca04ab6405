"""What is wrong between archive, ledger and plan, and what would put it right. Reads and hashes; changes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Row, select
from sqlalchemy.engine import Connection

from coordinator.archive.contract import index_of_file
from coordinator.expansion.catalog import Catalog
from coordinator.ledger.keepers import all_keepers
from coordinator.ledger.tables import episodes
from coordinator.recovery.judge import Draws, StrayJudge
from coordinator.recovery.memory import validated_files
from coordinator.transfer.puller import Checker
from schemas.dataset import EpisodeSummary
from schemas.dataset_files import EPISODES, QUARANTINE
from schemas.plan import Plan
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place, children, digest_of

__all__ = ["Survey", "survey_archive"]

ProgressCallback = Callable[[int, int], None]


@dataclass
class Survey:
    """Findings by what is to be done about them; `why` is in words."""

    whole: int = 0
    """Episodes on disk that the ledger owns, bit for bit."""
    adopt: list[EpisodeSummary] = field(default_factory=list)
    """Whole episodes of the plan that the ledger does not own as they are."""
    restore: list[tuple[Place, EpisodeSummary]] = field(default_factory=list)
    """Whole episodes of the plan that are in quarantine and nowhere else."""
    quarantine: list[tuple[Place, str]] = field(default_factory=list)
    requeue: list[tuple[int, str]] = field(default_factory=list)


def survey_archive(
    root: Place, plan: Plan, catalog: Catalog, ledger: Connection | None, checker: Checker, tell: ProgressCallback
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
    judge = StrayJudge(Draws(plan, catalog, ledger), checker, ledger, validated_files(root, plan))
    for done, (index, path) in enumerate(files.items(), 1):
        reason = _difference(path, owned[index]) if index in owned else "the ledger does not own it"
        if not reason:
            result.whole += 1
        else:
            _judge(path, index, reason, judge, result, is_owned=index in owned, is_kept=index in away)
        tell(done, len(files))
    gone = owned.keys() - files.keys() - away.keys()
    found = {summary.index for summary in result.adopt} | (owned.keys() - gone)
    result.restore += _restorable(root, judge, found)
    back = {summary.index for _, summary in result.restore}
    result.requeue += [(index, "its file is missing") for index in sorted(gone - back)]
    result.requeue = [(index, why) for index, why in result.requeue if index not in back]
    return result


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


def _difference(path: Place, row: Row[Any]) -> str:
    size = path.stat().st_size
    if size != row.size:
        return f"{size} bytes; in the ledger {row.size}"
    try:
        found = digest_of(path)
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    return "" if found == row.sha256 else f"SHA-256 {found}; in the ledger {row.sha256}"


def _judge(
    path: Place, index: int, reason: str, judge: StrayJudge, result: Survey, *, is_owned: bool, is_kept: bool
) -> None:
    verdict = judge.judge(path, index, replaces=is_owned)
    if not isinstance(verdict, str):
        result.adopt.append(verdict)
        return
    result.quarantine.append((path, f"{reason}; {verdict}" if is_owned else verdict))
    if is_owned and not is_kept:  # else a gateway has it still
        result.requeue.append((index, reason))


def _restorable(root: Place, judge: StrayJudge, found: Set[int]) -> Iterator[tuple[Place, EpisodeSummary]]:
    """Yields what was put aside although it is a whole episode of the plan, where the dataset has none."""
    had = set(found)
    for path in children(root / QUARANTINE):
        name, _, mark = path.name.rpartition(".")
        index = index_of_file(name) if mark != "txt" else None
        if index is None or index in had or not path.is_file() or path.is_symlink():
            continue
        verdict = judge.judge(path, index, replaces=True)
        if not isinstance(verdict, str):
            had.add(index)
            yield path, verdict
