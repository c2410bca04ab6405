"""Bringing a bundle home: over the network, or from the disk on which the archive lies, too."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from coordinator.archive.opening import open_archive
from coordinator.puller import Nearby, Pullers, nothing_nearby
from coordinator.settings import CoordinatorSettings
from coordinator.wire.protocol import Pull
from schemas.keys import Chunk
from schemas.wire import Lease
from tests.builders.bundle import job_for

BUNDLE = b"0123456789" * 1000
LEASE = Lease(job_id=1, fence=1, token="0" * 32)


@dataclass
class House:
    """A ledger and a judge that agree with everything, and a worker that serves `BUNDLE`; all take notes."""

    fetched: list[Chunk] = field(default_factory=list)
    judged: list[bytes] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    done: threading.Event = field(default_factory=threading.Event)

    def fetch(self, _sid: str, _lease: Lease, chunk: Chunk) -> bytes:
        self.fetched.append(chunk)
        return BUNDLE[chunk.offset : chunk.offset + chunk.length]

    def check(self, path: Path, _job: Any, _target: Any = None) -> Any:
        self.judged.append(path.read_bytes())
        return SimpleNamespace(num_steps=1)

    def keep(self, _pull: Pull, _seconds: float) -> bool:
        return True

    def is_owned(self, _index: int) -> bool:
        return False

    def own(self, _pull: Pull, _receipt: Any) -> bool:
        return True

    def refuse(self, _pull: Pull, detail: str) -> None:
        self.refused.append(detail)
        self.done.set()

    def close(self) -> None:
        pass


@contextmanager
def brought(root: Path, nearby: Nearby) -> Iterator[tuple[House, Path]]:
    """Has one bundle brought, and gives what was noted and where it has to lie."""
    house = House()
    settings = CoordinatorSettings(pullers=1, chunk_bytes=4096, reserve_bytes=0)
    sha256 = hashlib.sha256(BUNDLE).hexdigest()
    with open_archive(root / "data") as archive:
        with Pullers(archive, house, house.fetch, house, settings, house.done.set, nearby=nearby) as pullers:
            target: Any = None
            pullers.offer(Pull(LEASE, "worker", sha256, len(BUNDLE), job_for(7), target))
            assert house.done.wait(10)
        place = archive.path_of(7)
        assert isinstance(place, Path)
        assert list((root / "data" / ".staging").iterdir()) == []
        yield house, place


def spooled(root: Path, data: bytes) -> Path:
    path = root / "spool.zip"
    path.write_bytes(data)
    return path


def test_a_bundle_comes_over_the_network_in_parts(tmp_path: Path) -> None:
    with brought(tmp_path, nothing_nearby) as (house, place):
        assert place.read_bytes() == BUNDLE
        assert [chunk.offset for chunk in house.fetched] == [0, 4096, 8192]


def test_a_bundle_on_the_archives_disk_is_neither_fetched_nor_copied(tmp_path: Path) -> None:
    path = spooled(tmp_path, BUNDLE)
    with brought(tmp_path, lambda lease: path if lease == LEASE else None) as (house, place):
        assert house.fetched == []
        assert house.judged == [BUNDLE]
        assert place.samefile(path)
        path.unlink()
        assert place.read_bytes() == BUNDLE


def test_a_bundle_that_cannot_be_taken_is_fetched(tmp_path: Path) -> None:
    for source in (tmp_path / "gone.zip", spooled(tmp_path, b"torn"), tmp_path / "gone" / "too.zip"):
        root = tmp_path / source.stem
        with brought(root, lambda _lease, source=source: source) as (house, place):  # type: ignore[misc]
            assert place.read_bytes() == BUNDLE
            assert len(house.fetched) == 3


def test_a_bundle_on_the_archives_disk_must_be_the_one_announced(tmp_path: Path) -> None:
    path = spooled(tmp_path, bytes(reversed(BUNDLE)))
    with brought(tmp_path, lambda _lease: path) as (house, place):
        assert not place.exists()
        assert "arrived" in house.refused[0]
        assert path.exists()


def test_a_spool_that_cannot_be_looked_into_is_asked_over_the_network(tmp_path: Path) -> None:
    def vanished(_lease: Lease) -> Path:
        raise FileNotFoundError("dropped meanwhile")

    with brought(tmp_path, vanished) as (house, place):
        assert place.read_bytes() == BUNDLE
        assert len(house.fetched) == 3
