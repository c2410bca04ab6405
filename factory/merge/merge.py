"""Merges datasets into a new one: copies or links their episodes under new numbers, and records where each is from.

The dataset is made in a hidden folder beside its place and renamed when it is complete and verified, so no incomplete
dataset is visible; the same command continues an interrupted merge. Sources are not changed.

Design: docs/design/data.md#merged-datasets.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import pyarrow.compute as pc

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.archive.staging import is_held
from coordinator.expansion.catalog import read_entry
from coordinator.expansion.instances import Side, Sides, shared_categories
from coordinator.expansion.scene_cells import scene_cells
from coordinator.packing import pack_all
from coordinator.tables.row_groups import ListedRows, RowSource
from coordinator.tables.split_tables import write_split_tables
from coordinator.tables.table_reader import read_failed_attempts
from coordinator.tables.write import DatasetTables, TableContent
from factory.dataset.packages import find_package_file
from factory.dataset.reader import Dataset
from factory.dataset.site import Site
from factory.merge.merged_plan import merged_plan
from factory.runs.catalog import write_target_lists
from factory.runs.ledger import require_outside_datasets
from factory.support.text import format_bytes
from factory.verify.dataset import verify
from schemas.base import Model
from schemas.dataset.meta import DatasetMeta, DatasetSource
from schemas.dataset.rows import EpisodeSummary, FailedAttempt, renumbered
from schemas.errors import ArchiveCorrupt, UsageError, WorldError
from schemas.job import episode_id
from schemas.plan import MAX_EPISODES, Plan
from schemas.storage.dataset_files import ATTEMPTS_FILE, EPISODES, RUN_SHARD_FILE, SCENES, SOURCES_FILE
from schemas.storage.disk import free_bytes, sync_directory, translated
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import FilePlace, Place, digest_of
from schemas.storage.shards import MAX_SHARD_EPISODES
from schemas.support.shell import quoted
from schemas.terms import Recording

ProgressCallback = Callable[[int, int], None]
_NAMED, _LISTED = 3, 10
_BLOCK_BYTES = 1 << 20
_SPARE_BYTES = 256 << 20
"""Free space that a merge leaves, bytes; the tables need less."""
_ORDER_FILE = ".merge.json"


@dataclass(frozen=True)
class MergedPart:
    """Dataset that becomes part of another one."""

    name: str
    """Name of the dataset in messages and in the result."""
    dataset: Dataset
    offset: int
    """Number of planned episodes before it."""

    @property
    def sources(self) -> tuple[DatasetSource, ...]:
        """Runs of the dataset with their new numbers; those of a merged dataset keep their own entries."""
        meta = self.dataset.meta
        if not meta.sources:
            whole = DatasetSource(
                name=self.name,
                run=meta.run,
                plan_digest=meta.plan_digest,
                plan=meta.plan,
                first=self.offset + 1,
                episodes=meta.episodes,
                dataset_digest=meta.dataset_digest,
            )
            return (whole,)
        return tuple(
            each.model_copy(update={"name": f"{self.name}/{each.name}", "first": self.offset + each.first})
            for each in meta.sources
        )

    def rows(self) -> Iterator[EpisodeSummary]:
        """Yields the rows with the new numbers of the episodes, ascending."""
        for position in range(len(self.dataset)):
            row = self.dataset.row(position)
            # an interrupted extension may have written more rows than the description of the dataset states
            if row.index <= self.dataset.meta.planned:
                index = self.offset + row.index
                yield renumbered(row, index, episode_id(index))

    def failures(self) -> Iterator[FailedAttempt]:
        """Yields the failed attempts with the new ids of their episodes."""
        for row in read_failed_attempts(self.dataset.root / ATTEMPTS_FILE):
            own = int(row.episode_id.removeprefix("ep_"))
            if own <= self.dataset.meta.planned:
                yield row.model_copy(update={"episode_id": episode_id(self.offset + own)})


class MergeReport(Model):
    """Result of a merge."""

    dataset: str
    """Directory of the dataset."""
    run: str
    """Name of the plan and the first digits of its digest."""
    sources: tuple[DatasetSource, ...]
    """Runs of the dataset."""
    episodes: int
    """Number of episodes."""
    planned: int
    """Number of planned episodes."""
    linked: bool
    """Whether the episodes are hard links to those of the sources."""
    bytes: int
    """Size of the episodes."""
    digest: str | None
    """Digest of the dataset; null if an episode is missing."""


def open_parts(places: Sequence[Place], *, is_partial: bool) -> tuple[MergedPart, ...]:
    """Opens the datasets to merge, in order, and checks that they can become one dataset.

    Args:
        places: location of each dataset.
        is_partial: whether datasets may lack planned episodes.

    Raises:
        UsageError: a dataset is given twice, is unfinished, relabelled or a shard, or an episode is in two of them.
        WorldError: a location contains no dataset.
        ArchiveCorrupt: a table is damaged.
    """
    if len(places) < 2:
        raise UsageError("give at least two datasets to merge")
    _require_different(places)
    parts: list[MergedPart] = []
    for place in places:
        dataset = Dataset(place)
        _require_mergeable(place, dataset.meta, is_partial)
        names = {part.name for part in parts}
        name = next(name for name in _names_of(place) if name not in names)
        parts.append(MergedPart(name, dataset, sum(part.dataset.meta.planned for part in parts)))
    if sum(part.dataset.meta.planned for part in parts) > MAX_EPISODES:
        raise UsageError(f"the datasets have more than {MAX_EPISODES} planned episodes: merge fewer of them")
    _require_equal_scenes(parts)
    _require_no_duplicates(parts)
    return tuple(parts)


def _names_of(place: Place) -> Iterator[str]:
    base = (place.absolute().name if isinstance(place, Path) else place.name) or "dataset"
    yield base
    number = 2
    while True:
        yield f"{base}-{number}"
        number += 1


def _require_different(places: Sequence[Place]) -> None:
    known: dict[str, Place] = {}
    for place in places:
        key = str(place.resolve() if isinstance(place, Path) else place)
        if key in known:
            raise UsageError(f"{place} and {known[key]} are the same dataset: give it once")
        known[key] = place


def _require_mergeable(place: Place, meta: DatasetMeta, is_partial: bool) -> None:
    if (place / RUN_SHARD_FILE).is_file():
        raise UsageError(
            f"{place} is a shard of a run: join the shards with `factory gather PLAN SHARD... --out DIR`, and merge DIR"
        )
    if meta.relabelling is not None:
        raise UsageError(
            f"{place} is relabelled: merge the datasets with their recorded instructions, and relabel the result with "
            "`factory relabel`"
        )
    if isinstance(place, Path) and is_held(place):
        raise WorldError(f"{place} is in use by a coordinator: stop it, or wait for its end")
    if not meta.episodes:
        raise UsageError(f"{place} has no episodes")
    if not meta.complete and not is_partial:
        continued = "" if meta.sources else f"finish it with `factory run --out {quoted(place)}`, or "
        raise UsageError(
            f"{place} has {meta.episodes} of {meta.planned} planned episodes: {continued}merge what it has with "
            "--partial"
        )


def _require_equal_scenes(parts: Sequence[MergedPart]) -> None:
    packages: dict[str, tuple[str, str]] = {}
    for part in parts:
        for scene, sha256 in part.dataset.meta.scenes.items():
            name, other = packages.setdefault(scene, (part.name, sha256))
            if other != sha256:
                raise UsageError(
                    f"{name} and {part.name} have different packages of scene {scene} ({other[:16]} and "
                    f"{sha256[:16]}), "
                    "and a dataset has one package for each scene name: generate one of the datasets again with "
                    "`factory run PLAN --scenes` and the folder `scenes` of the other"
                )


def _require_no_duplicates(parts: Sequence[MergedPart]) -> None:
    owners: dict[str, tuple[MergedPart, str]] = {}
    for part in parts:
        names, digests = (part.dataset.column(name).to_pylist() for name in ("episode_id", "content_digest"))
        twice = [(name, owners[digest]) for name, digest in zip(names, digests, strict=True) if digest in owners]
        if twice:
            some = ", ".join(f"{name} is {other[0].name}'s {other[1]}" for name, other in twice[:_NAMED])
            raise UsageError(
                f"{len(twice)} of {len(names)} episodes of {part.name} are also in {twice[0][1][0].name} (equal "
                "content "
                f"digests): {some}{', ...' if len(twice) > _NAMED else ''}; give each episode once, and runs of one "
                "plan "
                "different --seed values"
            )
        owners |= {digest: (part, name) for name, digest in zip(names, digests, strict=True)}


def merge(
    parts: Sequence[MergedPart],
    out: Path,
    now: datetime,
    *,
    is_linked: bool = False,
    on_progress: ProgressCallback = lambda _done, _all: None,
) -> MergeReport:
    """Merges datasets into a new directory.

    Args:
        parts: datasets, opened by `open_parts`.
        out: directory of the result, which does not exist or is empty.
        now: time of the merge, UTC.
        is_linked: whether to make hard links instead of copies; the disk must be the same.
        on_progress: called with the number of copied and verified episodes and their total.

    Raises:
        UsageError: `out` exists or is inside a dataset, or the plans cannot share a dataset.
        WorldError: the disk is too small or cannot be written, or another merge writes to `out`.
        ArchiveCorrupt: an episode of a source is missing or damaged.
    """
    if out.is_file() or (out.is_dir() and any(out.iterdir())):
        raise UsageError(f"-o {out} exists and is not empty: choose another directory")
    require_outside_datasets(Site(out, out))
    plan = merged_plan([(source.name, source.plan) for part in parts for source in part.sources])
    work = out.absolute().with_name(f".{out.absolute().name}.merging")
    total = sum(len(part.dataset) for part in parts)
    size = sum(pc.sum(part.dataset.column("file_bytes")).as_py() for part in parts)
    with translated("create", work):
        work.mkdir(parents=True, exist_ok=True)
    with open_archive(work) as archive:
        _keep_matching(work, parts)
        if not is_linked:
            _require_room(out, size - _bytes_in(work))
        done = 0
        for part in parts:
            add_scenes(archive, part.dataset)
            for _ in add_episodes(archive, part, is_linked):
                done += 1
                on_progress(done, 2 * total)
        sources = [source for part in parts for source in part.sources]
        meta = write_joined(archive, parts, plan=plan, sources=sources, now=now)
        _require_intact(work, lambda checked, _all: on_progress(total + checked, 2 * total))
        _publish(work, out)
    return MergeReport(
        dataset=str(out),
        run=meta.run,
        sources=meta.sources,
        episodes=meta.episodes,
        planned=meta.planned,
        linked=is_linked,
        bytes=size,
        digest=meta.dataset_digest,
    )


def add_scenes(archive: Archive, dataset: Dataset) -> None:
    """Stores the scenes of a dataset, with their textures and the lists of targets for people."""
    catalog = {
        name: read_entry(find_package_file(dataset.root, name, sha256)) for name, sha256 in dataset.meta.scenes.items()
    }
    for name, entry in catalog.items():
        archive.add_scene(entry.path, name, entry.sha256, entry.textures)
    write_target_lists(catalog, archive.root)


def add_episodes(archive: Archive, part: MergedPart, is_linked: bool = False) -> Iterator[int]:
    """Stores the episodes of a dataset under their new numbers, and yields the number of each.

    An equal file that an interrupted call has stored is kept; another file with that number is replaced.

    Raises:
        UsageError: the source is on another disk, so hard links are impossible.
        WorldError: the disk is full.
        ArchiveCorrupt: an episode of the source is missing or differs from its row.
    """
    present = archive.present()
    files = list_episodes(part.dataset.root).episodes
    for row in part.rows():
        if row.index not in present or digest_of(present[row.index]) != row.file_sha256:
            archive.unpublish(row.index)
            own = row.index - part.offset
            if own not in files:
                raise ArchiveCorrupt(
                    f"{part.dataset.root} lacks {episode_id(own)}, which its tables list: gather the episodes of its "
                    "gateways with `factory gather`, or repair it with `factory repair`"
                )
            _add_episode(archive, row, files[own], is_linked)
        yield row.index


def _add_episode(archive: Archive, row: EpisodeSummary, source: FilePlace, is_linked: bool) -> None:
    with archive.stage(row.index) as staged:
        try:
            if is_linked and isinstance(source, Path):
                staged.link(source)
            else:
                with source.open("rb") as file:
                    while block := file.read(_BLOCK_BYTES):
                        staged.write(block)
        except OSError as error:
            if is_linked:
                raise UsageError(f"{source} cannot be linked ({error.strerror}): leave --link out") from error
            raise ArchiveCorrupt(f"{source} cannot be read: {error.strerror}") from error
        if staged.sha256 != row.file_sha256:
            root = source.parents[1]
            raise ArchiveCorrupt(
                f"{source} has SHA-256 {staged.sha256[:16]}..., recorded {row.file_sha256[:16]}...: repair the dataset "
                f"with `factory repair {quoted(root)}`"
            )
        archive.publish(staged, row.index)


class _RowsInOrder:
    """Rows of several datasets, read once in the order of their numbers, as the table writer requests them."""

    def __init__(self, parts: Sequence[MergedPart]) -> None:
        self._rows = (row for part in parts for row in part.rows())
        self._next = next(self._rows, None)

    def rows(self, first: int, last: int) -> Iterator[EpisodeSummary]:
        """Yields the rows of the episodes from `first`, which no call may have passed, to `last`."""
        while self._next is not None and self._next.index <= last:
            assert self._next.index >= first
            yield self._next
            self._next = next(self._rows, None)


def write_joined(
    archive: Archive, parts: Sequence[MergedPart], *, plan: Plan, sources: Sequence[DatasetSource], now: datetime
) -> DatasetMeta:
    """Writes the tables of a dataset with sources, and packs its episodes if it is large.

    Args:
        archive: archive with the episodes and scenes.
        parts: datasets, ascending.
        plan: plan of the whole dataset.
        sources: runs of the whole dataset.
        now: time of writing, UTC.
    """
    scenes = {name: sha256 for part in parts for name, sha256 in part.dataset.meta.scenes.items()}
    refused = {name: why for part in parts for name, why in part.dataset.meta.refused_seeds.items()}
    failures = [
        row for part in parts for row in part.failures()
    ]  # read before the tables of an extended dataset change
    if archive.shards() or (plan.record is Recording.STATES and plan.episodes > MAX_SHARD_EPISODES):
        pack_all(archive, {row.index: row.file_sha256 for part in parts for row in part.rows()})
    joined = JoinedRows(_RowsInOrder(parts), ListedRows(failures))
    return write_tables_of(archive, joined, plan=plan, sources=sources, scenes=scenes, refused=refused, now=now)


class JoinedRows(NamedTuple):
    """Rows of a dataset with sources, under its numbers."""

    episodes: RowSource
    failures: RowSource


def write_tables_of(
    archive: Archive,
    rows: JoinedRows,
    *,
    plan: Plan,
    sources: Sequence[DatasetSource],
    scenes: Mapping[str, str],
    refused: Mapping[str, tuple[str, ...]],
    now: datetime,
) -> DatasetMeta:
    """Writes all tables of a dataset with sources, and a copy of its description for `factory repair`."""
    sides, shared = _sides(archive.root, sources, plan, scenes)
    content = TableContent(
        plan,
        scenes,
        episodes=rows.episodes,
        failures=rows.failures,
        sides=sides,
        shared=shared,
        refused_seeds=refused,
        sources=sources,
    )
    meta = DatasetTables(has_sources=True).write(archive, content, now)
    with archive.replacing(SOURCES_FILE) as part:
        part.write_text(meta.model_dump_json(indent=1), encoding="utf-8")
    write_split_tables(archive)
    return meta


def _sides(
    root: Place, sources: Sequence[DatasetSource], plan: Plan, scenes: Mapping[str, str]
) -> tuple[Mapping[str, Sides], Mapping[str, tuple[str, ...]] | None]:
    """Returns the sides of the instances by scene, and the categories with shared instances.

    An instance that one run trains on and another one evaluates is shared.
    """
    if not plan.disjoint_instances:
        return {}, None
    sides: dict[str, dict[str, Side]] = {}
    shared: dict[str, tuple[str, ...]] = {}
    for name, sha256 in scenes.items():
        entry = read_entry(find_package_file(root, name, sha256))
        known: dict[str, Side] = {}
        for source in sources:
            if name in {part.name for part in source.plan.parts}:
                own = scene_cells(source.plan, source.plan.part(name), entry).sides
                known = {
                    **known,
                    **{key: side if known.get(key, side) is side else Side.SHARED for key, side in own.items()},
                }
        if known:
            sides[name], shared[name] = known, shared_categories(known, entry)
    return sides, shared


def _keep_matching(work: Path, parts: Sequence[MergedPart]) -> None:
    """Deletes what another merge has left in the hidden folder; keeps the episodes of an interrupted equal one."""
    order = json.dumps([[str(part.dataset.root), part.dataset.digest] for part in parts])
    path = work / _ORDER_FILE
    if path.is_file() and path.read_text(encoding="utf-8") == order:
        return
    with translated("write", work):
        for folder in (EPISODES, SCENES):
            for file in (work / folder).rglob("*"):
                if not file.is_dir():
                    file.unlink()
        path.write_text(order, encoding="utf-8")


def _bytes_in(work: Path) -> int:
    return sum(file.stat().st_size for file in (work / EPISODES).iterdir())


def _require_room(out: Path, needed: int) -> None:
    free = free_bytes(out.absolute().parent)
    if free < needed + _SPARE_BYTES:
        raise WorldError(
            f"{out.absolute().parent} has {format_bytes(free)} free, but the episodes need {format_bytes(needed)} and "
            f"{format_bytes(_SPARE_BYTES)} stay free: choose another -o, or make hard links with --link, which needs "
            "the "
            "disk of the datasets"
        )


def _require_intact(work: Path, on_progress: ProgressCallback) -> None:
    """Verifies the merged dataset, and deletes it if it has faults."""
    report = verify(work, on_progress=on_progress)
    if report.findings:
        lines = "".join(f"\n  - {each.kind} {each.file}: {each.text}" for each in report.findings[:_LISTED])
        shutil.rmtree(work)
        raise ArchiveCorrupt(
            f"the merged dataset has {len(report.findings)} faults and was deleted; verify the datasets with `factory "
            f"verify`:{lines}"
        )


def _publish(work: Path, out: Path) -> None:
    with translated("write", out):
        (work / _ORDER_FILE).unlink()
        work.rename(out)  # replaces an empty directory
        sync_directory(out.absolute().parent)
