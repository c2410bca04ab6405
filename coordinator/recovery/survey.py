"""Compares archive, ledger and plan, and determines the repair actions. Reads and hashes files, and changes nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from itertools import count

from sqlalchemy.engine import Connection

from coordinator.archive.difference import GONE, ListedFile, RecordedFile, diff_archive
from coordinator.expansion.catalog import Catalog
from coordinator.ledger.gateway_episodes import recorded_files
from coordinator.recovery.stray_files import PlannedDraws, StrayClassifier
from coordinator.recovery.table_records import validated_files
from coordinator.transfer.contract import EpisodeValidator
from schemas.dataset.rows import EpisodeSummary
from schemas.job import index_of_file
from schemas.plan import Plan
from schemas.storage.dataset_files import QUARANTINE
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import FilePlace, Place, children, digest_of

ProgressCallback = Callable[[int, int], None]


@dataclass
class Survey:
    """Findings by repair action."""

    whole: int = 0
    """Number of episode files that equal their ledger record."""
    adopt: list[EpisodeSummary] = field(default_factory=list)
    """Intact episodes of the plan whose ledger record is missing or differs from the file."""
    restore: list[tuple[Place, EpisodeSummary]] = field(default_factory=list)
    """Intact episodes of the plan that exist in the quarantine folder only, with their paths."""
    quarantine: list[tuple[FilePlace, str]] = field(default_factory=list)
    """Files to quarantine, with the reason."""
    requeue: list[tuple[int, str]] = field(default_factory=list)
    """Episodes to collect again, with the reason."""


def survey_archive(
    root: Place,
    plan: Plan,
    catalog: Catalog,
    ledger: Connection | None,
    checker: EpisodeValidator,
    on_progress: ProgressCallback,
) -> Survey:
    """Compares every file of a dataset with the ledger, and files without a record with the plan.

    Args:
        root: root of the dataset.
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        ledger: connection for reading; `None` if the ledger is lost.
        checker: validator of files to adopt.
        on_progress: progress callback with the number of processed files and the total.
    """
    result = Survey()
    recorded = recorded_files(ledger) if ledger is not None else {}
    listed = list_episodes(root)
    files = listed.episodes
    result.quarantine += [(path, "its name is not that of an episode") for path in listed.foreign]
    classifier = StrayClassifier(PlannedDraws(plan, catalog, ledger), checker, ledger, validated_files(root, plan))
    difference = diff_archive(_read_files(files, recorded, on_progress), recorded)
    result.whole = len(difference.same) + len(difference.elsewhere)
    for done, index in enumerate(difference.strays, result.whole + 1):
        _classify(files[index], index, difference.changed.get(index), classifier, result, recorded.get(index))
        on_progress(done, len(files))
    missing = set(difference.missing)
    found = {summary.index for summary in result.adopt} | (recorded.keys() - missing)
    result.restore += _restorable(root, classifier, found)
    back = {summary.index for _, summary in result.restore}
    result.requeue += [(index, GONE) for index in sorted(missing - back)]
    result.requeue = [(index, why) for index, why in result.requeue if index not in back]
    return result


def _read_files(
    files: Mapping[int, FilePlace], recorded: Mapping[int, RecordedFile], on_progress: ProgressCallback
) -> dict[int, ListedFile]:
    """Returns size and digest of each file; reports progress for each file that equals its record.

    The digest is omitted if the file has no record or not the recorded size.
    """
    found, done = {}, count(1)
    for index, path in files.items():
        found[index] = _read_file(path, recorded.get(index))
        if index in recorded and found[index].sha256 == recorded[index].sha256:
            on_progress(next(done), len(files))
    return found


def _read_file(path: FilePlace, record: RecordedFile | None) -> ListedFile:
    size = path.stat().st_size
    if record is None or size != record.size:
        return ListedFile(size)
    try:
        return ListedFile(size, digest_of(path))
    except OSError as error:
        return ListedFile(size, fault=f"cannot be read: {error.strerror}")


def _classify(
    path: FilePlace,
    index: int,
    change: str | None,
    classifier: StrayClassifier,
    result: Survey,
    record: RecordedFile | None,
) -> None:
    verdict = classifier.classify(path, index, replaces=change is not None)
    if not isinstance(verdict, str):
        result.adopt.append(verdict)
        return
    result.quarantine.append((path, f"{change}; {verdict}" if change else verdict))
    # an episode that a gateway stores is not lost
    if change and record is not None and record.gateway is None:
        result.requeue.append((index, change))


def _restorable(root: Place, classifier: StrayClassifier, found: Set[int]) -> Iterator[tuple[Place, EpisodeSummary]]:
    """Yields quarantined files that are intact episodes of the plan and missing in the dataset."""
    had = set(found)
    for path in children(root / QUARANTINE):
        name, _, mark = path.name.rpartition(".")
        index = index_of_file(name) if mark != "txt" else None
        if index is None or index in had or not path.is_file() or path.is_symlink():
            continue
        verdict = classifier.classify(path, index, replaces=True)
        if not isinstance(verdict, str):
            had.add(index)
            yield path, verdict
