"""Simulated workers that deliver valid bundles: copies of recorded episodes with the jobs that they claim.

`deliver_copies` is the main function of a process. Simulates no episodes.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path

import zenoh

from schemas.bundle import BundleReader, EpisodeArrays, member_names, seal
from schemas.encoding.container import ContainerWriter
from schemas.episode import EpisodeMeta
from schemas.errors import TransientError
from schemas.job import Job
from schemas.protocol.keys import RANGE_FIELDS, Chunk, Verb, bundle_key, parse_bundle_ranges
from schemas.protocol.messages import Beat, BeatReply, ClaimReply, Done, Lease
from tests.benchmarks.fleet import BenchWorker

_META = "meta.json"
_BEAT_S, _HURRIED_S = 2.0, 0.5
"""Pauses between two heartbeats, seconds. `_HURRIED_S` applies if at least half of the bundles that may wait for the
coordinator are waiting."""


class RecordedBundle:
    """Recorded bundle that can be copied for other jobs with the same target, start and template."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file, BundleReader(file) as bundle:
            self.meta: EpisodeMeta = bundle.meta
            self._arrays: EpisodeArrays = replace(bundle.arrays)
            names = member_names(bundle.length if bundle.has_frames else 0)
            self._members = [(name, bundle.stored(name)) for name in names if name != _META]

    def copy(self, job: Job) -> bytes:
        """Returns a copy of the bundle for another job, with valid digests."""
        meta = self.meta.model_copy(update={"job": job, "episode_id": job.episode_id})
        sealed, file = seal(meta, meta.frame_digests, self._arrays), BytesIO()
        with ContainerWriter(file) as out:
            for name, data in self._members:
                out.add(name, data)
            out.add(_META, sealed.model_dump_json(indent=1).encode())
        return file.getvalue()


class BundleCopies:
    """Copies of recorded bundles by job; copies for jobs that are known in advance are made at construction.

    Args:
        recordings: Recorded bundles. The episode number of a job determines which of them is copied.
        jobs: Jobs whose bundles are made now; the bundle of any other job is made when the job is claimed.
    """

    def __init__(self, recordings: Sequence[RecordedBundle], jobs: Sequence[Job] = ()) -> None:
        self._recordings = recordings
        self._ready = {job.index: (job, *self._make(job)) for job in jobs}

    def of(self, job: Job) -> tuple[bytes, str]:
        """Returns the bundle of a job and its SHA-256."""
        ready = self._ready.pop(job.index, None)
        return ready[1:] if ready is not None and ready[0] == job else self._make(job)

    def _make(self, job: Job) -> tuple[bytes, str]:
        data = self._recordings[job.index % len(self._recordings)].copy(job)
        return data, hashlib.sha256(data).hexdigest()


class DeliveringWorker(BenchWorker):
    """Simulated worker that delivers a copy of a recording for each claimed job.

    Args:
        endpoints: Endpoints of the coordinator.
        run: Name of the run.
        copies: Bundles of the jobs.
        is_validated: Whether the worker announces its bundles as validated.
        at_once: Largest number of bundles of this worker that wait for the coordinator.
    """

    def __init__(
        self, endpoints: Sequence[str], run: str, copies: BundleCopies, is_validated: bool, at_once: int
    ) -> None:
        self._copies = copies
        self._is_validated, self._at_once = is_validated, at_once
        self._waiting: dict[tuple[int, int], tuple[Lease, bytes]] = {}
        self._beaten = 0.0
        super().__init__(endpoints, run)

    def deliver_first(self) -> None:
        """Registers the worker and delivers one bundle, which the coordinator validates completely."""
        self.introduce()
        self._deliver_next()
        self._wait_for_archive()

    def deliver_all(self) -> None:
        """Claims and delivers jobs until the run is finished."""
        while self._deliver_next():
            while len(self._waiting) >= self._at_once:
                self._drop_archived(_HURRIED_S)
            # like a real worker, sends heartbeats more often when its spool is half full
            if 2 * len(self._waiting) >= self._at_once:
                self._drop_archived(_HURRIED_S, waits=False)
            else:
                self._drop_archived(_BEAT_S, waits=False)
        self._wait_for_archive()

    def _deliver_next(self) -> bool:
        """Claims a job and announces its bundle; returns whether there was a job."""
        reply = ClaimReply.model_validate_json(self.ask_for_work())
        if reply.job is None or reply.lease is None:
            return False
        data, digest = self._copies.of(reply.job)
        self._waiting[reply.lease.job_id, reply.lease.fence] = reply.lease, data
        done = Done(sid=self.sid, lease=reply.lease, sha256=digest, size=len(data), is_validated=self._is_validated)
        self.ask(Verb.DONE, done)
        return True

    def _wait_for_archive(self) -> None:
        while self._waiting:
            self._drop_archived(_HURRIED_S)

    def _drop_archived(self, pause_s: float, *, waits: bool = True) -> None:
        """Sends a heartbeat and drops the bundles that have been archived.

        If the last heartbeat was less than `pause_s` seconds ago, first waits for the rest of the pause, or does
        nothing if `waits` is false.
        """
        left_s = self._beaten + pause_s - time.monotonic()
        if left_s > 0 and not waits:
            return
        time.sleep(max(0.0, left_s))
        self._beaten = time.monotonic()
        leases = tuple(lease for lease, _ in self._waiting.values())
        try:
            reply = BeatReply.model_validate_json(self.ask(Verb.BEAT, Beat(sid=self.sid, spool=leases)))
        except TransientError:
            return
        for lease in reply.drop:
            self._waiting.pop((lease.job_id, lease.fence), None)

    def _serve(self, query: zenoh.Query) -> None:
        with query:
            asked = parse_bundle_ranges({name: query.parameters.get(name) or "" for name in RANGE_FIELDS})
            found = [self._waiting.get((job_id, fence)) for job_id, fence, _ in asked]
            parts = [_range(of[1], part) for of, (*_, part) in zip(found, asked, strict=True) if of]
            query.reply(bundle_key(self._run, self.sid), b"".join(parts))


def _range(data: bytes, part: Chunk) -> bytes:
    """Returns a byte range of a bundle."""
    return data[part.offset : part.offset + part.length]


def deliver_copies(
    pipe: Connection,
    endpoints: Sequence[str],
    run: str,
    members: int,
    paths: Sequence[Path],
    jobs: Sequence[Job],
    is_validated: bool,
    at_once: int,
) -> None:
    """Delivers one bundle of each worker and sends the number of workers through the pipe.

    After a message from the pipe, delivers all other bundles and sends the wall time that this took, seconds.
    """
    copies = BundleCopies([RecordedBundle(path) for path in paths], jobs)
    fleet = [DeliveringWorker(endpoints, run, copies, is_validated, at_once) for _ in range(members)]
    _run_all([member.deliver_first for member in fleet])
    pipe.send(len(fleet))
    pipe.recv()
    started = time.perf_counter()
    _run_all([member.deliver_all for member in fleet])
    pipe.send(time.perf_counter() - started)
    for member in fleet:
        member.close()


def _run_all(work: Sequence[Callable[[], None]]) -> None:
    with ThreadPoolExecutor(len(work)) as pool:
        for done in [pool.submit(each) for each in work]:
            done.result()
