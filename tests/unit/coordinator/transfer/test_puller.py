"""Pulling a bundle over the network, or linking it from the disk of the archive."""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from structlog.testing import capture_logs

from coordinator.archive.opening import open_archive
from coordinator.protocol.bundles import IncomingBundle
from coordinator.settings import CoordinatorSettings
from coordinator.transfer.contract import FindLocalBundle, ValidatedBundle, no_local_bundle
from coordinator.transfer.puller import Pullers
from coordinator.validation.messages import Scope, ValidationTask, check_each
from schemas.errors import TransientError
from schemas.protocol.keys import BundleRange, Chunk
from schemas.protocol.messages import Lease
from tests.builders.bundle import job_for
from tests.builders.wire_worker import until

BUNDLE = b"0123456789" * 1000
LEASE = Lease(job_id=1, fence=1, token="0" * 32)


@dataclass
class RecordingParts:
    """A ledger and a validator that accept everything, and a worker that serves `BUNDLE`; all record their calls."""

    fetched: list[Chunk] = field(default_factory=list)
    validated: list[bytes] = field(default_factory=list)
    scopes: list[Scope] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    barred: list[str] = field(default_factory=list)
    checked: list[bool] = field(default_factory=list)
    done: threading.Event = field(default_factory=threading.Event)

    def fetch(self, _sid: str, ranges: Sequence[BundleRange]) -> bytes:
        self.fetched += [each.chunk for each in ranges]
        return b"".join(BUNDLE[chunk.offset :][: chunk.length] for *_, chunk in ranges)

    def check(self, path: Path, _job: Any, _target: Any = None, scope: Scope = Scope.ALL) -> Any:
        data = path.read_bytes()
        self.validated.append(data)
        self.scopes.append(scope)
        return SimpleNamespace(num_steps=1, file_sha256=hashlib.sha256(data).hexdigest())

    def check_all(self, bundles: Sequence[tuple[Path, ValidationTask]]) -> list[Any]:
        return check_each(self.check, bundles)

    def keep(self, pulls: Sequence[IncomingBundle], _seconds: float) -> list[bool]:
        return [True] * len(pulls)

    def is_recorded(self, _index: int) -> bool:
        return False

    def record_archived(self, bundles: Sequence[ValidatedBundle]) -> list[bool]:
        self.checked += [validated.is_checked for validated in bundles]
        return [True] * len(bundles)

    def refuse(self, _pull: IncomingBundle, detail: str, *, is_false: bool = False) -> None:
        self.barred += [detail] if is_false else []
        self.refused.append(detail)
        self.done.set()

    def close(self) -> None:
        pass


@contextmanager
def pulled(root: Path, find_local_bundle: FindLocalBundle) -> Iterator[tuple[RecordingParts, Path]]:
    """Pulls one bundle; returns the recorded calls and its expected path."""
    recorded = RecordingParts()
    settings = CoordinatorSettings(pullers=1, chunk_bytes=4096, reserve_bytes=0)
    sha256 = hashlib.sha256(BUNDLE).hexdigest()
    with open_archive(root / "data") as archive:
        with Pullers(
            archive,
            recorded,
            recorded.fetch,
            recorded,
            settings,
            recorded.done.set,
            find_local_bundle=find_local_bundle,
        ) as pullers:
            target: Any = ()
            pullers.offer(IncomingBundle(LEASE, "worker", sha256, len(BUNDLE), job_for(7), target))
            assert recorded.done.wait(60)
        place = archive.path_of(7)
        assert isinstance(place, Path)
        assert list((root / "data" / ".staging").iterdir()) == []
        yield recorded, place


def spooled(root: Path, data: bytes) -> Path:
    path = root / "spool.zip"
    path.write_bytes(data)
    return path


def test_a_bundle_is_fetched_over_the_network_in_parts(tmp_path: Path) -> None:
    with pulled(tmp_path, no_local_bundle) as (recorded, place):
        assert place.read_bytes() == BUNDLE
        assert [chunk.offset for chunk in recorded.fetched] == [0, 4096, 8192]
        assert recorded.scopes == [Scope.ALL]


def test_a_bundle_on_the_archives_disk_is_neither_fetched_nor_copied(tmp_path: Path) -> None:
    path = spooled(tmp_path, BUNDLE)
    with pulled(tmp_path, lambda lease: path if lease == LEASE else None) as (recorded, place):
        assert recorded.fetched == []
        assert (recorded.validated, recorded.scopes) == ([BUNDLE], [Scope.SAMPLE])
        assert place.samefile(path)
        path.unlink()
        assert place.read_bytes() == BUNDLE


def test_a_bundle_that_cannot_be_linked_is_fetched(tmp_path: Path) -> None:
    for source in (tmp_path / "gone.zip", spooled(tmp_path, b"torn"), tmp_path / "gone" / "too.zip"):
        root = tmp_path / source.stem
        with pulled(root, lambda _lease, source=source: source) as (recorded, place):  # type: ignore[misc]
            assert place.read_bytes() == BUNDLE
            assert len(recorded.fetched) == 3


def test_a_bundle_on_the_archives_disk_that_differs_from_the_announced_bundle_is_refused(tmp_path: Path) -> None:
    path = spooled(tmp_path, bytes(reversed(BUNDLE)))
    with pulled(tmp_path, lambda _lease: path) as (recorded, place):
        assert not place.exists()
        assert "arrived" in recorded.refused[0]
        assert path.exists()


def test_a_bundle_in_an_unreadable_spool_is_fetched_over_the_network(tmp_path: Path) -> None:
    def vanished(_lease: Lease) -> Path:
        raise FileNotFoundError("dropped meanwhile")

    with pulled(tmp_path, vanished) as (recorded, place):
        assert place.read_bytes() == BUNDLE
        assert len(recorded.fetched) == 3


def test_refused_bundles_of_one_host_do_not_fill_the_log(tmp_path: Path) -> None:
    recorded, count = RecordingParts(), 60
    settings = CoordinatorSettings(pullers=1, reserve_bytes=0)
    target: Any = ()
    with (
        capture_logs() as lines,
        open_archive(tmp_path / "data") as archive,
        Pullers(archive, recorded, recorded.fetch, recorded, settings, recorded.done.set) as pullers,
    ):
        for index in range(1, count + 1):
            pullers.offer(IncomingBundle(LEASE, "host.1", "0" * 64, len(BUNDLE), job_for(index), target))
        pullers.offer(IncomingBundle(LEASE, "other.1", "0" * 64, len(BUNDLE), job_for(count + 1), target))
        until(lambda: len(recorded.refused) == count + 1)
    hosts = [line["worker"] for line in lines if line["event"] == "bundle_refused"]
    assert 1 <= hosts.count("host.1") < 10
    assert hosts.count("other.1") == 1


class SlowHosts(RecordingParts):
    """Workers of several hosts; a worker whose name starts with `slow` delays every chunk."""

    def __init__(self, pause_s: float) -> None:
        super().__init__()
        self.pause_s = pause_s
        self.owned: list[str] = []
        self.changed = threading.Event()

    def fetch(self, sid: str, ranges: Sequence[BundleRange]) -> bytes:
        if sid.startswith("slow"):
            time.sleep(self.pause_s)
        return super().fetch(sid, ranges)

    def record_archived(self, bundles: Sequence[ValidatedBundle]) -> list[bool]:
        self.owned += [validated.bundle.sid for validated in bundles]
        self.changed.set()
        return [True] * len(bundles)


def pull_of(sid: str, index: int, data: bytes = BUNDLE) -> IncomingBundle:
    target: Any = ()
    lease = LEASE.model_copy(update={"job_id": index})
    return IncomingBundle(lease, sid, hashlib.sha256(data).hexdigest(), len(data), job_for(index), target)


@pytest.mark.parametrize("slow_hosts", [1, 2, 10])
def test_slow_hosts_do_not_delay_the_bundle_of_another_host(tmp_path: Path, slow_hosts: int) -> None:
    slow = SlowHosts(pause_s=0.3)
    settings = CoordinatorSettings(pullers=2, chunk_bytes=1024, reserve_bytes=0)
    with (
        open_archive(tmp_path / "data") as archive,
        Pullers(archive, slow, slow.fetch, slow, settings, slow.done.set) as pullers,
    ):
        for number in range(3 * slow_hosts):
            pullers.offer(pull_of(f"slow-{number % slow_hosts}.1", number + 10))
        time.sleep(0.5)
        pullers.offer(pull_of("quick.1", 7))
        assert slow.changed.wait(60)
    assert slow.owned[0] == "quick.1"
    assert list((tmp_path / "data" / ".staging").iterdir()) == []


def test_interleaved_transfers_arrive_intact(tmp_path: Path) -> None:
    slow = SlowHosts(pause_s=0.1)
    settings = CoordinatorSettings(pullers=1, chunk_bytes=1024, reserve_bytes=0)
    with (
        open_archive(tmp_path / "data") as archive,
        Pullers(archive, slow, slow.fetch, slow, settings, slow.done.set) as pullers,
    ):
        for number in range(4):
            pullers.offer(pull_of(f"slow-{number}.1", number + 1))
        while pullers.waiting:
            time.sleep(0.05)
    assert len(slow.owned) == 4
    assert slow.validated == [BUNDLE] * 4
    assert slow.refused == []


def test_a_worker_that_serves_too_slowly_is_refused(tmp_path: Path) -> None:
    slow = SlowHosts(pause_s=0.05)
    settings = CoordinatorSettings(
        pullers=1, chunk_bytes=1024, reserve_bytes=0, slow_start_s=0.2, min_bytes_per_s=10_000_000
    )
    with (
        open_archive(tmp_path / "data") as archive,
        Pullers(archive, slow, slow.fetch, slow, settings, slow.done.set) as pullers,
    ):
        pullers.offer(pull_of("slow-1.1", 1))
        assert slow.done.wait(60)
    assert slow.owned == []
    assert "too slow" in slow.refused[0]


@pytest.mark.parametrize("size", [0, 1])
def test_a_bundle_that_is_announced_repeatedly_but_not_served_is_refused(tmp_path: Path, size: int) -> None:
    recorded, asked = RecordingParts(), threading.Event()

    def fetch(_sid: str, ranges: Sequence[BundleRange]) -> bytes:
        ((*_, chunk),) = ranges
        if chunk.offset >= size * 1024:
            asked.set()
            raise TransientError("no answer in time")
        return BUNDLE[: chunk.length]

    settings = CoordinatorSettings(
        pullers=1, chunk_bytes=1024, reserve_bytes=0, slow_start_s=0.2, min_bytes_per_s=10_000_000
    )
    pull = IncomingBundle(LEASE, "worker", hashlib.sha256(BUNDLE).hexdigest(), len(BUNDLE), job_for(7), ())  # type: ignore[arg-type]
    with (
        open_archive(tmp_path / "data") as archive,
        Pullers(archive, recorded, fetch, recorded, settings, recorded.done.set) as pullers,
    ):
        for _ in range(600):  # heartbeats also offer the same bundle repeatedly
            pullers.offer(pull)
            if recorded.done.wait(0.05):
                break
    assert asked.is_set()
    assert len(recorded.refused) == 1
    assert f"not served: {size * 1024} of {len(BUNDLE)} bytes" in recorded.refused[0]


def test_a_bundle_whose_transfers_fail_briefly_is_fetched(tmp_path: Path) -> None:
    recorded, failures = RecordingParts(), iter(range(3))

    def fetch(sid: str, ranges: Sequence[BundleRange]) -> bytes:
        if next(failures, None) is not None:
            raise TransientError("no answer in time")
        return recorded.fetch(sid, ranges)

    settings = CoordinatorSettings(pullers=1, chunk_bytes=4096, reserve_bytes=0, slow_start_s=0.0)
    pull = IncomingBundle(LEASE, "worker", hashlib.sha256(BUNDLE).hexdigest(), len(BUNDLE), job_for(7), ())  # type: ignore[arg-type]
    with (
        open_archive(tmp_path / "data") as archive,
        Pullers(archive, recorded, fetch, recorded, settings, recorded.done.set) as pullers,
    ):
        for _ in range(600):
            pullers.offer(pull)
            if recorded.done.wait(0.05):
                break
    assert recorded.refused == []
    assert recorded.validated == [BUNDLE]


def test_space_is_reserved_for_bundles_in_transfer(tmp_path: Path) -> None:
    slow = SlowHosts(pause_s=0.1)
    with open_archive(tmp_path / "data") as archive:
        free = archive.free_bytes()
        settings = CoordinatorSettings(pullers=2, chunk_bytes=1024, reserve_bytes=max(0, free - (1 << 30)))
        with Pullers(archive, slow, slow.fetch, slow, settings, slow.done.set) as pullers:
            for number in (1, 2):
                pullers.offer(replace(pull_of(f"slow-{number}.1", number), size=(1 << 30) - (200 << 20)))
            while pullers.waiting == 2:
                time.sleep(0.02)
            assert pullers.waiting == 1
