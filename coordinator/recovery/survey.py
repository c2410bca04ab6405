"""Compares archive, ledger, tables and plan, and determines the repair actions.

Identifies the attempt of episode files without a record, and restores records of a lost ledger from the tables. Reads
and hashes files; moves and writes none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from datetime import datetime
from itertools import count
from types import MappingProxyType

from sqlalchemy import Engine, select
from sqlalchemy.engine import Connection

from coordinator.archive.difference import GONE, ListedFile, RecordedFile, diff_archive
from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand, redraw, to_job
from coordinator.ledger.archived import recorded_files
from coordinator.ledger.opening import planned_of
from coordinator.ledger.repair import obstacle_to, record_failures
from coordinator.ledger.tables import jobs
from coordinator.tables.checkpoint import count_failures, read_failures
from coordinator.tables.table_reader import read_column, read_failed_attempts
from coordinator.transfer.contract import EpisodeValidator
from schemas.bundle import BundleReader
from schemas.dataset.meta import read_dataset_meta
from schemas.dataset.rows import EpisodeSummary, FailedAttempt, summary_of
from schemas.episode_spec import columns_of
from schemas.errors import InvalidBundle, WorldError
from schemas.exchangeable import candidates_of
from schemas.job import Job, episode_id, index_of_file
from schemas.plan import Plan
from schemas.storage.dataset_files import ATTEMPTS_FILE, METADATA_FILE, QUARANTINE
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import FilePlace, Place, children, digest_of, local_copy


def validated_files(root: Place, plan: Plan) -> Mapping[int, str]:
    """Returns the SHA-256 of the validated file by episode number, from `metadata.parquet`.

    Args:
        root: root of the dataset.
        plan: plan of the run; rows of other plans are ignored.
    """
    columns = [read_column(root / METADATA_FILE, name) for name in ("index", "file_sha256", "plan_digest")]
    if any(isinstance(column, str) for column in columns):
        return {}
    return {
        int(index): sha256
        for index, sha256, digest in zip(*columns, strict=True)
        if digest == plan.digest and index.isdecimal()
    }


def restore_failures(
    engine: Engine,
    root: Place,
    plan: Plan,
    catalog: Catalog,
    now: datetime,
    whole: Mapping[int, EpisodeSummary],
) -> None:
    """Records the failed attempts that `attempts.parquet` lists and the ledger lacks.

    Does nothing if the table is not ahead of the ledger, which is the normal case: the table is written from the
    ledger.

    Args:
        engine: engine of the ledger writer.
        root: root of the dataset.
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        now: time of the repair.
        whole: rows of the files to adopt, by episode number.
    """
    with engine.begin() as connection:
        if not whole and _failed_attempts(root) <= count_failures(connection):
            return
        known = list(read_failures(connection))
        failures = list(failures_of(root, PlannedDraws(plan, catalog, connection)))
        ends = {index: (summary.draw, summary.attempt) for index, summary in whole.items()}
        record_failures(connection, plan, catalog=catalog, failures=failures, known=known, now=now, whole=ends)


def _failed_attempts(root: Place) -> int:
    try:
        return read_dataset_meta(root).failed_attempts
    except WorldError:
        return 0


def failures_of(root: Place, draws: PlannedDraws) -> Iterator[FailedAttempt]:
    """Yields the rows of `attempts.parquet` that match the plan's draws; a table of another run must not change jobs.

    Args:
        root: root of the dataset.
        draws: draws of the plan.
    """
    for one in read_failed_attempts(root / ATTEMPTS_FILE):
        number = one.episode_id.removeprefix("ep_")
        planned = draws.planned(int(number), one.draw) if number.isdecimal() else None
        if planned is None:
            continue
        wanted = columns_of(planned.episode, FailedAttempt)
        if all(getattr(one, column) == value for column, value in wanted.items()):
            yield one


_SAMPLE = 25
"""Approximate number of episodes that `count_plans` opens."""
# the episodes of a dataset are of one run, except after a mistake, so a few of them show its plan; in object storage,
# each is a download


class ForeignEpisode(str):
    """Reason for rejecting a file: it is an episode of another run."""


class PlannedDraws:
    """Draws of the episodes of a plan.

    Args:
        plan: plan of the run.
        catalog: compiled scenes of the plan.
        ledger: connection to an intact ledger of the run, which avoids expanding the plan; `None` without a ledger.
    """

    def __init__(self, plan: Plan, catalog: Catalog, ledger: Connection | None = None) -> None:
        self.plan, self.catalog = plan, catalog
        self._ledger = ledger
        self._first: Mapping[int, PlannedJob] | None = None

    def planned(self, index: int, draw: int) -> PlannedJob | None:
        """Returns a draw of an episode, or `None` if the plan has no such draw."""
        planned = self._first_of(index)
        if planned is None or not 0 <= draw < self.plan.budget.draws:
            return None
        for _ in range(draw):
            planned = redraw(self.plan, self.catalog, planned)
        return planned

    def job(self, index: int, draw: int, attempt: int) -> Job | None:
        """Returns the job of an attempt, or `None` if the plan has no such draw."""
        planned = self.planned(index, draw)
        return None if planned is None else to_job(self.plan, self.catalog, planned, attempt)

    def _first_of(self, index: int) -> PlannedJob | None:
        if self._ledger is not None:
            row = self._ledger.execute(select(jobs).where(jobs.c.idx == index, jobs.c.draw == 0)).first()
            return None if row is None else planned_of(row)
        if self._first is None:
            self._first = {planned.index: planned for planned in expand(self.plan, self.catalog)}
        return self._first.get(index)


class StrayClassifier:
    """Classifier of episode files.

    Args:
        draws: draws of the plan.
        checker: validator of bundles.
        ledger: connection to the ledger of the run; `None` if it is lost.
        validated: mapping of episode number to the SHA-256 of its validated file, from `metadata.parquet`. A file with
            this digest is not validated again.
    """

    def __init__(
        self,
        draws: PlannedDraws,
        checker: EpisodeValidator,
        ledger: Connection | None,
        validated: Mapping[int, str] = MappingProxyType({}),
    ) -> None:
        self._draws, self._checker, self._ledger, self._validated = draws, checker, ledger, validated

    def classify(self, path: FilePlace, index: int, *, replaces: bool = False) -> EpisodeSummary | str:
        """Returns the row of the episode that a file contains, or the reason why it is rejected.

        Args:
            path: path of the file.
            index: episode number in the file name.
            replaces: whether the file may replace the file that the ledger records.

        Raises:
            TransientError: no bundle can be validated on this machine now.
        """
        try:
            with local_copy(path) as local:
                with local.open("rb") as file, BundleReader(file) as bundle:
                    meta = bundle.meta
                recorded, plan = meta.job, self._draws.plan
                if recorded.plan_digest != plan.digest:
                    return ForeignEpisode(
                        f"an episode of run {recorded.run}, which has a different plan than {plan.run}"
                    )
                job = self._draws.job(index, recorded.draw, recorded.attempt)
                if job is None:
                    return f"the plan has no draw {recorded.draw} of {episode_id(index)}"
                if self._ledger is not None:
                    obstacle = obstacle_to(self._ledger, index, recorded.draw, recorded.attempt, replaces=replaces)
                    if obstacle:
                        return obstacle
                sha256 = self._validated.get(index)
                if job == recorded and sha256 is not None and digest_of(local) == sha256:
                    return summary_of(meta, sha256, local.stat().st_size)
                return self._checker.check(local, job, candidates_of(job, self._draws.catalog[job.scene].info))
        except InvalidBundle as error:
            return str(error)
        except OSError as error:
            return f"cannot be read: {error.strerror}"


def count_plans(root: Place) -> Counter[str]:
    """Returns the number of episodes per plan digest in a sample of a dataset; damaged files are skipped."""
    files = list(list_episodes(root).episodes.values())
    plans: Counter[str] = Counter()
    for path in files[:: max(1, len(files) // _SAMPLE)]:
        try:
            with local_copy(path) as local, local.open("rb") as file, BundleReader(file) as bundle:
                plans[bundle.meta.job.plan_digest] += 1
        except (InvalidBundle, OSError):
            continue
    return plans


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
        _classify(
            files[index],
            index,
            change=difference.changed.get(index),
            classifier=classifier,
            result=result,
            record=recorded.get(index),
        )
        on_progress(done, len(files))
    missing = set(difference.missing)
    present = {summary.index for summary in result.adopt} | (recorded.keys() - missing)
    result.restore += _restorable(root, classifier, present)
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
    listed, done = {}, count(1)
    for index, path in files.items():
        listed[index] = _read_file(path, recorded.get(index))
        if index in recorded and listed[index].sha256 == recorded[index].sha256:
            on_progress(next(done), len(files))
    return listed


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


def _restorable(root: Place, classifier: StrayClassifier, indices: Set[int]) -> Iterator[tuple[Place, EpisodeSummary]]:
    """Yields quarantined files that are intact episodes of the plan and missing in the dataset."""
    had = set(indices)
    for path in children(root / QUARANTINE):
        name, _, mark = path.name.rpartition(".")
        index = index_of_file(name) if mark != "txt" else None
        if index is None or index in had or not path.is_file() or path.is_symlink():
            continue
        verdict = classifier.classify(path, index, replaces=True)
        if not isinstance(verdict, str):
            had.add(index)
            yield path, verdict
