"""Builds a finished run of minimal episodes with a real ledger, archive and tables. Simulates nothing."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from coordinator.archive.contract import Archive
from coordinator.archive.opening import open_archive
from coordinator.expansion.draw import to_job
from coordinator.ledger import outcomes
from coordinator.ledger.claims import lease_of
from coordinator.ledger.opening import ledger_url_of, planned_of
from coordinator.packing import pack_settled
from coordinator.recovery.repair_dataset import RepairInput
from coordinator.tables.checkpoint import write_checkpoint
from coordinator.tables.split_tables import write_split_tables
from schemas.dataset.rows import summary_of
from schemas.protocol.messages import Done
from schemas.terms import FailReason, Recording
from tests.builders.bundle import BundleParts, parts_for
from tests.builders.ledger import TTL_S, TimedLedger, room_catalog, room_plan


class ArchivedRun:
    """A dataset directory with `done` archived episodes; `timed_ledger` gives access to its ledger.

    Args:
        root: directory of the dataset.
        planned: number of planned episodes.
        done: number of archived episodes.
        misses: number of failed attempts of the first episode; each draw permits two attempts.
        record: what the episodes store.
    """

    def __init__(
        self, root: Path, planned: int = 3, done: int = 3, misses: int = 0, record: Recording = Recording.FRAMES
    ) -> None:
        self.root = root
        root.mkdir()
        self.plan = room_plan(planned, record, attempts_per_draw=2, draws=3)
        self.catalog = room_catalog(root.parent)
        self.url = ledger_url_of(root)
        self.timed_ledger = TimedLedger(self.plan, self.url)
        self.timed_ledger.catalog = self.catalog
        with open_archive(root) as archive:
            for name, entry in self.catalog.items():
                archive.add_scene(entry.path, name, entry.sha256)
            for _ in range(misses):
                assert self.timed_ledger.fail(self.lease_of(1), FailReason.TIMEOUT)
            for index in range(1, done + 1):
                self.archive_episode(archive, index)
            self._write_tables(archive)
        self.timed_ledger.engine.dispose()

    def lease_of(self, index: int):  # type: ignore[no-untyped-def]
        """Claims jobs until the episode with that number is leased, releases the other jobs, and returns the lease."""
        others = []
        while True:
            row = self.timed_ledger.claim()
            assert row is not None
            if row.idx == index:
                break
            others.append(lease_of(row))
        for lease in others:
            self.timed_ledger.fail(lease, FailReason.RELEASED)
        return lease_of(row)

    def bundle(self, index: int) -> bytes:
        """Returns the bundle of the current attempt of an episode."""
        return self._parts(index).write()

    def repair_input(self, scenes: Sequence[str] = ()) -> RepairInput:
        """Returns the input of a repair of this directory, in which the packages of `scenes` are marked as damaged."""
        return RepairInput(self.root, self.root, self.url, self.plan, self.catalog, dict.fromkeys(scenes, "damaged"))

    def pack(self, size: int, *, is_over: bool = True) -> int:
        """Packs the settled ranges, each of `size` episodes, writes the tables, and returns the number of packed
        episodes."""
        with open_archive(self.root) as archive:
            with self.timed_ledger.engine.connect() as connection:
                packed = pack_settled(archive, connection, self.plan, is_over, size)
            self._write_tables(archive)
        self.timed_ledger.engine.dispose()
        return packed

    def file(self, index: int) -> Path:
        return self.root / "episodes" / f"ep_{index:06d}.zip"

    def digests(self) -> dict[int, str]:
        """Returns the SHA-256 of every episode on disk."""
        paths = sorted((self.root / "episodes").glob("ep_*.zip"))
        return {int(path.stem[3:]): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}

    def states(self) -> dict[int, str]:
        """Returns the state of the current draw of each episode."""
        return {row.idx: row.state for row in self.timed_ledger.rows() if not row.superseded}

    def archive_episode(self, archive: Archive, index: int) -> None:
        """Claims, announces and archives an episode."""
        lease = self.lease_of(index)
        data, sealed = self._parts(index).write_sealed()
        digest = hashlib.sha256(data).hexdigest()
        with archive.stage(index) as staged:
            staged.write(data)
            archive.publish(staged, index)
        done = Done(sid="host-1", lease=lease, sha256=digest, size=len(data))
        with self.timed_ledger.open() as connection:
            outcomes.announce(connection, done, self.timed_ledger.now, TTL_S)
            summary = summary_of(sealed, digest, len(data))
            assert outcomes.archive(connection, lease, summary, self.timed_ledger.now)

    def _parts(self, index: int) -> BundleParts:
        row = self.timed_ledger.rows(index)[-1]
        return parts_for(to_job(self.plan, self.catalog, planned_of(row), row.attempt))

    def _write_tables(self, archive: Archive) -> None:
        with self.timed_ledger.engine.connect() as connection:
            write_checkpoint(archive, connection, self.plan, self.catalog, self.timed_ledger.now)
        write_split_tables(archive)
