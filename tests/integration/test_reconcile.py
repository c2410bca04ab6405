"""Reconciles ledger and archive at start, with a real directory or bucket, ledger and validator."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import select

from coordinator.archive.opening import open_archive
from coordinator.expansion.draw import to_job
from coordinator.ledger import claims
from coordinator.ledger.opening import planned_of
from coordinator.ledger.outcomes import is_recorded
from coordinator.ledger.tables import jobs
from coordinator.protocol.protocol import Terms
from coordinator.recovery.reconcile import reconcile
from coordinator.validation.validator import Validator
from schemas.errors import TransientError
from schemas.protocol.messages import Lease
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place, children
from tests.builders.bundle import parts_for
from tests.builders.ledger import TTL_S, TimedLedger


@pytest.fixture(scope="module")
def validator() -> Iterator[Validator]:
    with Validator() as checking:
        yield checking


class Scene:
    """A ledger and an archive in the state between two starts of a coordinator."""

    def __init__(self, home: Path, validator: Validator, store: ObjectPath | None = None) -> None:
        self.timed_ledger = TimedLedger()
        self.home, self.store = home, store
        self.root: Place = store or home
        self.validator = validator
        self.terms = Terms(self.timed_ledger.plan, self.timed_ledger.catalog, "test", TTL_S, 1.0)

    def announce(self) -> tuple[Lease, bytes]:
        """Claims a job and announces its bundle."""
        row = self.timed_ledger.claim()
        assert row is not None
        job = to_job(self.timed_ledger.plan, self.timed_ledger.catalog, planned_of(row), row.attempt)
        bundle = parts_for(job).write()
        lease = claims.lease_of(row)
        self.timed_ledger.done(lease, sha256=hashlib.sha256(bundle).hexdigest())
        with self.timed_ledger.open() as connection:
            connection.execute(jobs.update().where(jobs.c.id == row.id).values(size=len(bundle)))
        return lease, bundle

    def lay(self, name: str, data: bytes) -> Place:
        """Writes a file into the folder of the episodes, as a crashed coordinator may have left it."""
        path = self.root / "episodes" / name
        if isinstance(path, ObjectPath):
            path.objects.put(path.key, data)
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        return path

    def start(self):
        with open_archive(self.home, self.store) as archive:
            return reconcile(archive, self.timed_ledger.engine, self.terms, self.validator, self.timed_ledger.now)

    def states(self) -> list[str]:
        with self.timed_ledger.open() as connection:
            return list(connection.execute(select(jobs.c.state).order_by(jobs.c.idx)).scalars())


@pytest.fixture(params=["directory", "bucket"])
def scene(request: pytest.FixtureRequest, tmp_path: Path, validator: Validator) -> Scene:
    if request.param == "directory":
        return Scene(tmp_path / "out", validator)
    new_bucket = request.getfixturevalue("bucket_url")
    return Scene(tmp_path / "home", validator, ObjectPath.at(f"{new_bucket()}/run"))


def test_a_published_bundle_whose_commit_was_lost_is_adopted(scene):
    _, bundle = scene.announce()
    path = scene.lay("ep_000001.zip", bundle)
    assert scene.start().adopted == [1]
    assert scene.states() == ["archived", "pending", "pending"]
    assert path.read_bytes() == bundle
    with scene.timed_ledger.open() as connection:
        assert is_recorded(connection, 1)
    assert scene.start().adopted == []


def test_a_file_that_cannot_be_validated_now_stays_and_is_adopted_later(scene, validator):
    _, bundle = scene.announce()
    path = scene.lay("ep_000001.zip", bundle)
    with Validator() as closed:
        pass
    scene.validator = closed
    with pytest.raises(TransientError, match="closed"):
        scene.start()
    assert path.read_bytes() == bundle
    scene.validator = validator
    assert scene.start().adopted == [1]


def test_a_truncated_bundle_is_quarantined_and_its_job_stays_submitted(scene):
    lease, bundle = scene.announce()
    path = scene.lay("ep_000001.zip", bundle[:-100])
    assert len(scene.start().quarantined) == 1
    assert not path.exists()
    assert scene.states()[0] == "submitted"
    assert scene.timed_ledger.row(lease.job_id).lease_until == scene.timed_ledger.now.timestamp() + 1.5 * TTL_S


def test_a_bundle_with_a_flipped_bit_is_quarantined(scene):
    _, bundle = scene.announce()
    flipped = bytearray(bundle)
    flipped[len(bundle) // 2] ^= 1
    scene.lay("ep_000001.zip", bytes(flipped))
    result = scene.start()
    assert (len(result.quarantined), result.adopted) == (1, [])


def test_unexpected_files_are_quarantined(scene):
    scene.lay("ep_000002.zip", b"stray")
    scene.lay("notes.txt", b"mine")
    result = scene.start()
    assert len(result.quarantined) == 2
    assert children(scene.root / "episodes") == []
    assert scene.states() == ["pending"] * 3


def test_an_episode_of_another_size_is_quarantined_and_requeued(scene):
    _, bundle = scene.announce()
    scene.lay("ep_000001.zip", bundle)
    scene.start()
    scene.lay("ep_000001.zip", bundle[:-1])
    result = scene.start()
    assert (result.requeued, len(result.quarantined)) == ([1], 1)
    assert scene.states()[0] == "pending"


def test_an_orphan_in_the_staging_directory_is_removed(scene):
    part = scene.home / ".staging" / "ep_000001.0.part"
    part.parent.mkdir(parents=True)
    part.write_bytes(b"half")
    scene.start()
    assert not part.exists()
