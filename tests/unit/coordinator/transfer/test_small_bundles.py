"""Small bundles of one worker share a request, a validation and a commit; a failing bundle affects only itself."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from coordinator.archive.opening import open_archive
from coordinator.protocol.bundles import IncomingBundle
from coordinator.settings import CoordinatorSettings
from coordinator.transfer.contract import ValidatedBundle
from coordinator.transfer.puller import Pullers
from coordinator.validation.messages import ValidationTask
from schemas.errors import InvalidBundle, TransientError
from schemas.protocol.keys import BundleRange
from schemas.protocol.messages import Lease
from tests.builders.bundle import job_for
from tests.builders.wire_worker import until

INVALID, LOST, STORED, EXPIRED, OTHER = 2, 3, 4, 5, 6


class Site:
    """Workers with one small bundle for each job, a validator and a ledger, which record their calls."""

    def __init__(self, unserved: Sequence[int] = ()) -> None:
        self.unserved = unserved
        self.requests: list[list[int]] = []
        self.validated: list[list[int]] = []
        self.owned: list[list[int]] = []
        self.kept: list[list[int]] = []
        self.refused: dict[int, str] = {}
        self.is_open = threading.Event()
        """Set when the ledger answers; bundles that are offered earlier wait together."""

    @staticmethod
    def bundle(index: int) -> bytes:
        return f"bundle {index}".encode() * 10

    def pull(self, index: int, sid: str = "host.1", sha256: str = "") -> IncomingBundle:
        data, target = self.bundle(index), ()
        lease = Lease(job_id=index, fence=1, token="0" * 32)
        digest = sha256 or hashlib.sha256(data).hexdigest()
        return IncomingBundle(lease, sid, digest, len(data), job_for(index), target)  # type: ignore[arg-type]

    def fetch(self, _sid: str, ranges: Sequence[BundleRange]) -> bytes:
        self.requests.append([each.job_id for each in ranges])
        if any(each.job_id in self.unserved for each in ranges):
            raise TransientError("no answer in time")
        return b"".join(self.bundle(each.job_id)[each.chunk.offset :][: each.chunk.length] for each in ranges)

    def check_all(self, bundles: Sequence[tuple[Path, ValidationTask]]) -> list[Any]:
        jobs = [task.job for _, task in bundles if task.job is not None]
        self.validated.append([job.index for job in jobs])
        for job, (path, task) in zip(jobs, bundles, strict=True):
            assert path.read_bytes() == self.bundle(job.index)
            assert task.sha256 == hashlib.sha256(self.bundle(job.index)).hexdigest()
        row, refusal = SimpleNamespace(num_steps=1), InvalidBundle("refused", ["x"])
        return [refusal if job.index == INVALID else row for job in jobs]

    def keep(self, pulls: Sequence[IncomingBundle], _seconds: float) -> list[bool]:
        assert self.is_open.wait(60)
        self.kept.append([pull.job.index for pull in pulls])
        return [pull.job.index != EXPIRED for pull in pulls]

    def record_archived(self, bundles: Sequence[ValidatedBundle]) -> list[bool]:
        self.owned.append([validated.bundle.job.index for validated in bundles])
        return [validated.bundle.job.index != LOST for validated in bundles]

    def is_recorded(self, index: int) -> bool:
        return index == STORED

    def refuse(self, pull: IncomingBundle, detail: str, *, is_false: bool = False) -> None:
        assert not is_false
        self.refused[pull.job.index] = detail

    def check(self, *_arguments: object) -> Any:
        raise AssertionError("bundles are validated together")

    def close(self) -> None:
        pass


def bring(site: Site, root: Path, pulls: Sequence[IncomingBundle]) -> list[int]:
    """Offers bundles that wait together behind a bundle of another host; returns the archived episodes."""
    settings = CoordinatorSettings(pullers=1, reserve_bytes=0)
    with open_archive(root / "data") as archive:
        with archive.stage(STORED) as staged:
            staged.write(b"stored")
            archive.publish(staged, STORED)
        with Pullers(archive, site, site.fetch, site, settings, lambda: None) as pullers:
            pullers.offer(site.pull(99, "busy.1"))
            until(lambda: pullers.waiting == 1)
            for pull in pulls:
                pullers.offer(pull)
            site.is_open.set()
            until(lambda: pullers.waiting == 0)
        assert list((root / "data" / ".staging").iterdir()) == []
        return [index for index in archive.present() if index != 99]


def test_small_bundles_of_one_worker_share_a_request_a_validation_and_a_commit(tmp_path: Path) -> None:
    site = Site()
    stored = bring(site, tmp_path, [site.pull(index) for index in (10, 11, 12)])
    assert stored == [STORED, 10, 11, 12]
    assert site.requests == site.validated == site.owned == [[99], [10, 11, 12]]
    assert site.kept == [[99], [99], [10, 11, 12], [10, 11, 12]]


def test_a_bundle_that_is_not_archived_does_not_affect_the_others(tmp_path: Path) -> None:
    site = Site()
    indices = (10, INVALID, LOST, STORED, EXPIRED, OTHER, 12)
    pulls = [site.pull(index, sha256="0" * 64 if index == OTHER else "") for index in indices]
    stored = bring(site, tmp_path, pulls)
    assert stored == [STORED, 10, 12]
    assert site.requests[1:] == [[10, INVALID, LOST, OTHER, 12]]
    assert site.owned[1:] == [[10, LOST, 12]]
    assert {index: detail.split()[0] for index, detail in site.refused.items()} == {
        INVALID: "refused:",
        OTHER: "SHA-256",
    }


def test_bundles_that_are_not_served_together_are_fetched_one_by_one(tmp_path: Path) -> None:
    site = Site(unserved=[11])
    stored = bring(site, tmp_path, [site.pull(index) for index in (10, 11, 12)])
    assert stored == [STORED, 10, 12]
    assert site.requests[1:] == [[10, 11, 12], [10], [11], [12]]
    assert site.refused == {}


@pytest.mark.parametrize("count", [32, 33, 70])
def test_a_turn_has_at_most_32_bundles(tmp_path: Path, count: int) -> None:
    site = Site()
    bring(site, tmp_path, [site.pull(index) for index in range(100, 100 + count)])
    assert [len(request) for request in site.requests[1:]] == [32] * (count // 32) + [count % 32] * (count % 32 > 0)


def test_sessions_of_one_host_do_not_share_a_request(tmp_path: Path) -> None:
    site = Site()
    bring(site, tmp_path, [site.pull(10), site.pull(11), site.pull(12, "host.2"), site.pull(13)])
    assert site.requests[1:] == [[10, 11], [12], [13]]
