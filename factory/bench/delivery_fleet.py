"""Simulated workers that deliver valid bundles: copies of recorded episodes with the jobs that they claim.

`deliver_copies` is the main function of a process. Simulates no episodes.
"""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path

import zenoh

from factory.bench.fleet import BenchWorker
from schemas.bundle import BundleReader, EpisodeArrays, member_names, seal
from schemas.encoding.container import ContainerWriter
from schemas.episode import EpisodeMeta
from schemas.errors import TransientError
from schemas.job import Job
from schemas.protocol.keys import Verb, bundle_key, parse_bundle_chunk
from schemas.protocol.messages import Beat, BeatReply, ClaimReply, Done, Lease

_META = "meta.json"
_BEAT_S = 2.0
_IDLE_S = 0.02


class RecordedBundle:
    """Recorded bundle that can be copied for other jobs with the same target, start and template."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file, BundleReader(file) as bundle:
            self.meta: EpisodeMeta = bundle.meta
            self._arrays: EpisodeArrays = replace(bundle.arrays)
            names = member_names(bundle.length if bundle.has_frames else 0)
            self._members = [(name, bundle.stored(name)) for name in names if name != _META]

    def copy(self, job: Job) -> bytes:
        """Returns the bundle of another job, with valid digests."""
        meta = self.meta.model_copy(update={"job": job, "episode_id": job.episode_id})
        sealed, file = seal(meta, meta.frame_digests, self._arrays), BytesIO()
        with ContainerWriter(file) as out:
            for name, data in self._members:
                out.add(name, data)
            out.add(_META, sealed.model_dump_json(indent=1).encode())
        return file.getvalue()


class DeliveringWorker(BenchWorker):
    """Simulated worker that delivers a copy of a recording for each claimed job.

    Args:
        endpoints: Endpoints of the coordinator.
        run: Name of the run.
        recordings: Recorded bundles; a job gets the one of its template and target.
        is_validated: Whether the worker announces its bundles as validated.
        at_once: Number of bundles that may wait for the coordinator.
    """

    def __init__(
        self, endpoints: Sequence[str], run: str, recordings: Sequence[RecordedBundle], is_validated: bool, at_once: int
    ) -> None:
        self._recordings = recordings
        self._is_validated, self._at_once = is_validated, at_once
        self._waiting: dict[tuple[int, int], tuple[Lease, bytes]] = {}
        super().__init__(endpoints, run)

    def deliver_all(self) -> None:
        """Claims and delivers jobs until the run is finished."""
        self.introduce()
        beaten, is_finished = 0.0, False
        while not is_finished or self._waiting:
            if time.monotonic() - beaten > _BEAT_S and self._waiting:
                self._drop_archived()
                beaten = time.monotonic()
            if len(self._waiting) >= self._at_once or is_finished:
                time.sleep(_IDLE_S)
                continue
            reply = ClaimReply.model_validate_json(self.ask_for_work())
            if reply.job is not None and reply.lease is not None:
                self._announce_copy(reply.job, reply.lease)
            else:
                is_finished = True

    def _announce_copy(self, job: Job, lease: Lease) -> None:
        data = self._recordings[job.index % len(self._recordings)].copy(job)
        self._waiting[lease.job_id, lease.fence] = lease, data
        digest = hashlib.sha256(data).hexdigest()
        done = Done(sid=self.sid, lease=lease, sha256=digest, size=len(data), is_validated=self._is_validated)
        self.ask(Verb.DONE, done)

    def _drop_archived(self) -> None:
        leases = tuple(lease for lease, _ in self._waiting.values())
        try:
            reply = BeatReply.model_validate_json(self.ask(Verb.BEAT, Beat(sid=self.sid, spool=leases)))
        except TransientError:
            return
        for lease in reply.drop:
            self._waiting.pop((lease.job_id, lease.fence), None)

    def _serve(self, query: zenoh.Query) -> None:
        with query:
            names = ("job", "fence", "off", "n")
            asked = parse_bundle_chunk({name: query.parameters.get(name) or "" for name in names})
            found = self._waiting.get((asked.job_id, asked.fence))
            if found is not None:
                query.reply(bundle_key(self._run, self.sid), found[1][asked.chunk.offset :][: asked.chunk.length])


def deliver_copies(
    pipe: Connection,
    endpoints: Sequence[str],
    run: str,
    members: int,
    paths: Sequence[Path],
    is_validated: bool,
    at_once: int,
) -> None:
    """Delivers all jobs of a run after a message; sends the number of workers, and the wall time, seconds."""
    recordings = [RecordedBundle(path) for path in paths]
    fleet = [DeliveringWorker(endpoints, run, recordings, is_validated, at_once) for _ in range(members)]
    pipe.send(len(fleet))
    pipe.recv()
    begun = time.perf_counter()
    threads = [threading.Thread(target=member.deliver_all) for member in fleet]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    pipe.send(time.perf_counter() - begun)
    for member in fleet:
        member.close()
