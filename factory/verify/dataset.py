"""Verifies a dataset: every file against the tables and, with `deep`, every frame and digest, and the plan's quotas.

Returns all findings; does not stop at the first. Does not write, print or need a ledger. Episodes are checked in
several processes if that saves more time than their start takes.
"""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from itertools import chain, islice
from types import MappingProxyType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import ValidationError

from coordinator.defaults import usable_cores
from coordinator.expansion.catalog import SceneEntry, read_entry
from coordinator.expansion.cells import planned_cells
from coordinator.tables.card import names_split_tables
from coordinator.tables.split_tables import FaultKind, find_faults
from factory.dataset.reader import Dataset, Episode
from factory.scenes.targets.target_list import list_file_name
from factory.support.logs import configure_logs
from factory.verify.episode import EpisodeCheck, EpisodeFindings, check_episode, targets_of
from factory.verify.findings import Finding, Kind, VerifyReport
from schemas.dataset.meta import DatasetMeta
from schemas.dataset.rows import EpisodeSummary
from schemas.errors import ArchiveCorrupt, InvalidBundle, UsageError
from schemas.job import episode_id
from schemas.scene.info import TEXTURES, texture_file
from schemas.storage.dataset_files import (
    ATTEMPTS_FILE,
    CARD_FILE,
    EPISODES,
    META_FILE,
    METADATA_FILE,
    SCENES,
    SHARDS_FILE,
    SPLITS_FOLDER,
    is_part,
)
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import Place, children, digest_of, local_copy, relative_name, table_of
from schemas.terms import Recording, Split, Tier

_ROWS_AT_A_TIME = 2000
_CHECKS_AT_A_TIME = 4
_BYTES_PER_S = 75e6
_EPISODE_S = 0.01
"""Part of the CPU time of a deep check that does not depend on the size of the episode, seconds."""
_WORTH_A_PROCESS_S = 2.0
"""CPU time of checks that justifies one more process, seconds: twice the CPU time of its start and imports."""


def run_checks(checks: Iterator[EpisodeCheck], processes: int | None) -> Iterator[EpisodeFindings]:
    """Yields the result of each check, in the order of the checks.

    Args:
        checks: Checks, read as they are needed.
        processes: Number of processes; 1 runs in the calling process. `None` uses the result of `useful_processes`.
    """
    batch = list(islice(checks, _ROWS_AT_A_TIME))
    count = min(useful_processes(batch, usable_cores()) if processes is None else processes, len(batch))
    if count <= 1:
        yield from map(check_episode, chain(batch, checks))
        return
    fresh = multiprocessing.get_context("spawn")  # a fork would copy locks held by other threads
    with ProcessPoolExecutor(count, fresh, initializer=configure_logs) as pool:
        while batch:  # `pool.map` reads all of its input at once
            yield from pool.map(check_episode, batch, chunksize=_CHECKS_AT_A_TIME if len(batch) > 100 else 1)
            batch = list(islice(checks, _ROWS_AT_A_TIME))


def useful_processes(checks: Sequence[EpisodeCheck], cores: int) -> int:
    """Returns the number of processes that finish the checks soonest; at most one per core.

    Each episode that is rendered again justifies a process, because rendering it takes seconds.
    """
    rendered = sum(check.render for check in checks)
    work_s = sum(_EPISODE_S + check.row.file_bytes / _BYTES_PER_S for check in checks if check.deep)
    return max(1, min(cores, rendered + int(work_s / _WORTH_A_PROCESS_S)))


class RowCheck:
    """Checks the rows of a dataset one by one, and adds what it finds to a report. Keeps no row.

    Args:
        dataset: Dataset to check.
        report: Report of the verification.
    """

    def __init__(self, dataset: Dataset, report: VerifyReport) -> None:
        self._dataset, self._report = dataset, report
        self.names: set[str] = set()
        """Ids of the episodes with a valid row."""
        self.cells: Counter[tuple[str, Split, Tier]] = Counter()
        """Number of valid rows by scene, split and tier."""
        self.plans: set[str] = set()
        """Digests of the plans in valid rows."""

    def __iter__(self) -> Iterator[EpisodeSummary]:
        """Yields the first valid row of each episode."""
        return (row for row in map(self._parse, self._dataset.rows()) if row is not None)

    def _parse(self, values: dict[str, Any]) -> EpisodeSummary | None:
        try:
            row = EpisodeSummary.model_validate(values)
        except ValidationError as error:
            where = sorted({str(item["loc"][0]) for item in error.errors() if item["loc"]})
            self._report.add(
                Kind.DAMAGED, METADATA_FILE, f"{values.get('episode_id')}: wrong values in {', '.join(where)}"
            )
            return None
        if row.episode_id != episode_id(row.index):
            self._report.add(Kind.CONTRADICTION, METADATA_FILE, f"{row.episode_id} has index {row.index}")
        if row.episode_id in self.names:
            self._report.add(Kind.CONTRADICTION, METADATA_FILE, f"{row.episode_id} has more than one row")
            return None
        self.names.add(row.episode_id)
        self.cells[row.scene, row.split, row.spawn_tier] += 1
        self.plans.add(row.plan_digest)
        return row


__all__ = ["Finding", "Kind", "VerifyReport", "verify"]

ProgressCallback = Callable[[int, int], None]
_KIND_OF_FAULT = MappingProxyType(
    {
        FaultKind.ABSENT: Kind.MISSING,
        FaultKind.SURPLUS: Kind.SURPLUS,
        FaultKind.DAMAGED: Kind.DAMAGED,
        FaultKind.OUTDATED: Kind.CONTRADICTION,
    }
)
_EXACT_POSES = 2
"""First bundle format with exact poses."""


def verify(
    root: Place,
    deep: bool = False,
    on_progress: ProgressCallback = lambda _done, _all: None,
    processes: int | None = 1,
    render: int = 0,
    reference: Place | None = None,
) -> VerifyReport:
    """Verifies a dataset.

    The shallow check reads all tables, compares them with each other, and compares size and SHA-256 of every file with
    them; it reports missing and additional files. The deep check also decodes every frame, recomputes digests and
    motion, compares rows with the episodes, hashes the scene packages, and compares the quotas with the plan.

    Args:
        root: Location of the dataset.
        deep: Whether to check the content of the episodes.
        on_progress: Called with the number of checked episodes and the total.
        processes: Number of processes that check episodes; 1 runs in the calling process. `None` chooses the fastest
            number, at most one per core.
        render: Number of episodes, evenly spread, whose frames are rendered again and compared with their digests.
        reference: Frames recording of the same episodes, with which rendered frames of a states recording are compared.

    Raises:
        WorldError: The dataset does not exist, its format is newer than this software, or frames are to be rendered
            and this machine cannot.
        UsageError: Frames are to be rendered, and the episodes have no exact poses; or the reference stores no frames.
    """
    report = VerifyReport(root, deep)
    try:
        dataset = Dataset(root)
        report.digest = dataset.digest
        next(dataset.rows(), None)  # reads all columns
    except ArchiveCorrupt as error:
        report.add(Kind.DAMAGED, str(root), str(error))
        return report
    meta = dataset.meta
    report.episodes, report.complete = len(dataset), meta.complete
    names = dataset.column("episode_id").to_pylist()
    _check_listing(root, set(names), report)
    _check_tables(dataset, report)
    drawn = _drawn_again(dict(zip(names, dataset.column("format").to_pylist(), strict=True)), render)
    report.rendered = len(drawn)
    rows = RowCheck(dataset, report)
    frames_of = _reference_episodes(reference, dataset, drawn)
    is_drawn = any(plan.language is not None and plan.language.exchangeable for plan in meta.plans)
    checks = _plan_checks(
        rows,
        _check_scenes(root, meta, report),
        report=report,
        drawn=drawn,
        frames_of=frames_of,
        meta=meta,
        is_drawn=is_drawn,
    )
    for done, result in enumerate(run_checks(checks, processes), 1):
        report.findings += result.findings
        report.difference.merge(result.difference)
        on_progress(done, len(dataset))
    if meta.episodes != len(rows.names):
        report.add(Kind.CONTRADICTION, META_FILE, f"{meta.episodes} episodes, {METADATA_FILE} has {len(rows.names)}")
    if deep:
        _check_quotas(meta, rows, report)
    return report


def _drawn_again(formats: Mapping[str, int], count: int) -> set[str]:
    """Returns the ids of at most `count` episodes, evenly spread over the dataset.

    Args:
        formats: Bundle format of each episode by id.
        count: Number of episodes.
    """
    if not count:
        return set()
    names = sorted(name for name in formats if name is not None)
    chosen = {names[place * len(names) // count] for place in range(count)} if count < len(names) else set(names)
    old = [name for name in sorted(chosen) if (formats[name] or 0) < _EXACT_POSES]
    if old:
        raise UsageError(
            f"{old[0]} has bundle format {formats[old[0]]}, whose poses are rounded to float32, so its frames "
            f"cannot be rendered again; verify without --render"
        )
    return chosen


def _reference_episodes(root: Place | None, dataset: Dataset, names: Iterable[str]) -> dict[str, Episode]:
    """Returns the episodes of a reference by id; omits those whose number of steps differs from the dataset's."""
    if root is None:
        return {}
    reference = Dataset(root)
    if reference.meta.plan.record is not Recording.FRAMES:
        raise UsageError(f"--reference {root} stores no frames; `factory render` makes a dataset that stores them")
    reference_episodes: dict[str, Episode] = {}
    for name in names:
        with suppress(KeyError, ArchiveCorrupt):  # the reference lacks the episode, or a row is damaged
            if len(reference[name]) == len(dataset[name]):
                reference_episodes[name] = reference[name]
    return reference_episodes


def _plan_checks(
    rows: Iterable[EpisodeSummary],
    scenes: dict[str, SceneEntry],
    report: VerifyReport,
    drawn: Collection[str],
    frames_of: Mapping[str, Episode],
    meta: DatasetMeta,
    is_drawn: bool,
) -> Iterator[EpisodeCheck]:
    for row in rows:
        candidates, findings = targets_of(row, scenes.get(row.scene), is_drawn)
        report.findings += findings
        name = row.episode_id
        package = scenes[row.scene].path if candidates else None
        frames = frames_of.get(name)
        yield EpisodeCheck(
            report.root,
            row,
            candidates=candidates,
            deep=report.deep,
            render=name in drawn,
            reference=frames,
            package=package,
            relabelled=meta.relabelling is not None,
            own_index=meta.own_index(row.index),
        )


def _check_listing(root: Place, names: Collection[str], report: VerifyReport) -> None:
    listed = list_episodes(root)
    for foreign in listed.foreign:
        report.add(Kind.FOREIGN, relative_name(foreign, root), "is not named like an episode")
    for name, damage in listed.damaged.items():
        report.add(Kind.DAMAGED, f"{EPISODES}/{name}", f"{damage}; `factory repair` keeps its intact episodes")
    for text in listed.twice:
        report.add(Kind.SURPLUS, EPISODES, f"{text}; if both copies are equal, `factory repair` keeps one")
    if listed.index_fault:
        report.add(Kind.CONTRADICTION, SHARDS_FILE, f"{listed.index_fault}; rewrite it with `factory repair`")
    for index, path in listed.episodes.items():
        if episode_id(index) not in names:
            report.add(
                Kind.SURPLUS,
                relative_name(path, root),
                f"{METADATA_FILE} does not list it (during a run, the table is updated with a delay)",
            )
    for entry in children(root):
        if not is_part(entry.name):
            report.add(Kind.FOREIGN, entry.name, "does not belong to a dataset")


def _check_tables(dataset: Dataset, report: VerifyReport) -> None:
    meta = dataset.meta
    if meta.plan.digest != meta.plan_digest:
        text = f"plan digest {meta.plan_digest}, but the digest of its plan is {meta.plan.digest}"
        report.add(Kind.CONTRADICTION, META_FILE, text)
    if meta.complete and meta.dataset_digest != report.digest:
        text = f"dataset digest {meta.dataset_digest}, but the digest computed from {METADATA_FILE} is {report.digest}"
        report.add(Kind.CONTRADICTION, META_FILE, text)
    try:
        attempts = sum(map(len, _batches(dataset.root / ATTEMPTS_FILE)))
    except FileNotFoundError:
        report.add(Kind.MISSING, ATTEMPTS_FILE, "is missing")
    except (pa.ArrowException, OSError) as error:
        report.add(Kind.DAMAGED, ATTEMPTS_FILE, f"cannot be read: {error}")
    else:
        if attempts != meta.failed_attempts:
            report.add(
                Kind.CONTRADICTION,
                ATTEMPTS_FILE,
                f"has {attempts} rows, but {META_FILE} has {meta.failed_attempts} failed attempts",
            )
    _check_split_tables(dataset, report)


def _batches(path: Place) -> Iterator[pa.RecordBatch]:
    """Yields all rows of a table, so every page of the Parquet file is read."""
    with pq.ParquetFile(table_of(path)) as file:
        yield from file.iter_batches()


def _check_split_tables(dataset: Dataset, report: VerifyReport) -> None:
    """Compares the split tables with `metadata.parquet`; in an unfinished run, they may be missing or outdated.

    A dataset whose card lists no split tables may have none.
    """
    try:
        card = (dataset.root / CARD_FILE).read_text(encoding="utf-8")
    except FileNotFoundError:
        report.add(Kind.MISSING, CARD_FILE, "is missing")
        card = ""
    lags = not dataset.meta.complete
    if not names_split_tables(card) and not children(dataset.root / SPLITS_FOLDER):
        return
    for fault in find_faults(dataset.root, report.deep):
        if not (lags and fault.kind in (FaultKind.ABSENT, FaultKind.OUTDATED)):
            report.add(_KIND_OF_FAULT[fault.kind], fault.name, f"{fault.text}; rewrite it with `factory repair`")


def _check_scenes(root: Place, meta: DatasetMeta, report: VerifyReport) -> dict[str, SceneEntry]:
    check_scenes: dict[str, SceneEntry] = {}
    expected = {f"{name}-{sha256[:16]}.scene.zip": (name, sha256) for name, sha256 in meta.scenes.items()}
    for_people = {list_file_name(name) for name in meta.scenes}
    for entry in children(root / SCENES):
        if entry.name not in {*expected, *for_people, TEXTURES}:
            report.add(Kind.FOREIGN, f"{SCENES}/{entry.name}", f"{META_FILE} does not list it")
    for file, (name, sha256) in expected.items():
        try:
            with local_copy(root / SCENES / file) as package:
                scene = read_entry(package)
        except FileNotFoundError:
            report.add(Kind.MISSING, f"{SCENES}/{file}", "is missing")
        except (InvalidBundle, OSError) as error:
            report.add(Kind.DAMAGED, f"{SCENES}/{file}", str(error))
        else:
            if scene.sha256 == sha256:
                check_scenes[name] = scene
            else:
                report.add(Kind.CHANGED, f"{SCENES}/{file}", f"SHA-256 {scene.sha256}, recorded {sha256}")
    _check_textures(root, check_scenes.values(), report, are_all=len(check_scenes) == len(expected))
    return check_scenes


def _check_textures(root: Place, scenes: Iterable[SceneEntry], report: VerifyReport, *, are_all: bool) -> None:
    """Compares each file of a texture, which several scenes may share, once with its digest."""
    needed = {f"{SCENES}/{texture_file(sha256)}": sha256 for scene in scenes for sha256 in scene.textures}
    present = {f"{SCENES}/{TEXTURES}/{place.name}": place for place in children(root / SCENES / TEXTURES)}
    for file in sorted(needed.keys() | present.keys()):
        if file not in present:
            report.add(Kind.MISSING, file, "is missing; restore it with `factory repair`")
        elif file in needed:
            sha256 = digest_of(present[file])
            if sha256 != needed[file]:
                report.add(Kind.DAMAGED, file, f"SHA-256 {sha256}; restore it with `factory repair`")
        elif are_all:  # if a package is unreadable, it is unknown which textures it needs
            report.add(Kind.FOREIGN, file, "no scene of the dataset needs it")


def _check_quotas(meta: DatasetMeta, rows: RowCheck, report: VerifyReport) -> None:
    """Compares the number of episodes in every cell with the plan; an incomplete dataset may have fewer."""
    recorded = rows.cells
    wanted = planned_cells(meta.plans)
    for key in sorted(recorded.keys() | wanted.keys()):
        have, want = recorded.get(key, 0), wanted.get(key, 0)
        if have > want or (meta.complete and have < want):
            report.add(Kind.CONTRADICTION, METADATA_FILE, f"{'/'.join(key)}: {have} episodes, the plan has {want}")
    runs = sorted(rows.plans - {plan.digest for plan in meta.plans})
    if runs:
        report.add(Kind.CONTRADICTION, METADATA_FILE, f"episodes of other plans: {', '.join(runs)}")
