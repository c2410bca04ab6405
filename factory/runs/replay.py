"""Simulates the job of an archived episode again and compares both episodes. Archives nothing.

Design: docs/design/reproducibility.md.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from factory.runs.scene_packages import find_package
from schemas.bundle import BundleReader
from schemas.dataset.origin import NOT_RECORDED, PACKAGE, EpisodeOrigin
from schemas.errors import WorldError
from schemas.storage.place import FilePlace, Place
from schemas.terms import Recording, RendererKind
from schemas.view import ViewSettings
from workers.sim.attempt import AttemptFailure, run_attempt
from workers.sim.context import SimulationContext


@dataclass(frozen=True)
class Replay:
    """Result of a replay."""

    episode_id: str
    archived_digest: str
    replayed_digest: str
    steps: int
    """Number of steps of the archived episode."""
    differences: dict[str, float]
    """Array -> largest absolute difference over the steps that both episodes have; empty for identical episodes."""
    fingerprint_changes: dict[str, tuple[str, str]]
    """Differing software versions and machine properties: (archived, here)."""

    @property
    def is_identical(self) -> bool:
        """Returns whether both content digests are equal."""
        return self.archived_digest == self.replayed_digest


def replay_episode(
    root: Place, episode: FilePlace, renderer: RendererKind, on_step: Callable[[int, int], None]
) -> Replay:
    """Simulates the job of an archived episode again. Renders in a separate process, so any program can call this.

    Args:
        root: Location of the dataset.
        episode: Path of the bundle.
        renderer: Renderer to use; `auto` uses the fastest available one.
        on_step: Called with the steps done and the steps of the archived episode.

    Raises:
        InvalidBundle: The archived bundle cannot be read.
        WorldError: The replayed attempt failed.
    """
    with episode.open("rb") as file, tempfile.TemporaryFile() as out, SimulationContext(renderer, apart=True) as stage:
        archived = BundleReader(file)
        job = archived.meta.job
        stage.load(find_package(root, job.scene, job.scene_sha256).path, job.scene_sha256)
        outcome = run_attempt(job, stage, out=out, sid="replay", on_step=lambda step: on_step(step, archived.length))
        if isinstance(outcome, AttemptFailure):
            raise WorldError(f"{episode.stem}: the replay ended with {outcome.reason}: {outcome.detail}")
        return _compare(archived, out, episode.stem)


def replay_origin(
    origin: EpisodeOrigin, package: Path, renderer: RendererKind, on_step: Callable[[int, int], None]
) -> Replay:
    """Simulates an exported episode again, without its dataset, and compares the digest of its states.

    Args:
        origin: origin that the export states.
        package: package of its scene.
        renderer: renderer to use; `auto` uses the fastest available one.
        on_step: called with the steps done and the largest possible number of steps.

    Raises:
        WorldError: the replayed attempt failed.
    """
    # a recording of states has the same states and does not encode frames
    job = origin.job.model_copy(update={"record": Recording.STATES, "view": ViewSettings()})
    with tempfile.TemporaryFile() as out, SimulationContext(renderer, apart=True) as stage:
        stage.load(package, job.scene_sha256)
        outcome = run_attempt(job, stage, out=out, sid="replay", on_step=lambda step: on_step(step, job.task.max_steps))
        if isinstance(outcome, AttemptFailure):
            raise WorldError(f"{origin.episode}: the replay ended with {outcome.reason}: {outcome.detail}")
        replayed = BundleReader(out)
        here = replayed.meta.provenance.fingerprint.software.get(PACKAGE, NOT_RECORDED)
        return Replay(
            episode_id=origin.episode,
            archived_digest=origin.states_digest,
            replayed_digest=replayed.states_digest(),
            steps=replayed.length,
            differences={},
            fingerprint_changes={} if here == origin.version else {PACKAGE: (origin.version, here)},
        )


def _compare(archived: BundleReader, out: BinaryIO, name: str) -> Replay:
    replayed = BundleReader(out)
    is_identical = archived.meta.content_digest == replayed.meta.content_digest
    return Replay(
        episode_id=name,
        archived_digest=archived.meta.content_digest,
        replayed_digest=replayed.meta.content_digest,
        steps=archived.length,
        differences={} if is_identical else _differences(archived, replayed),
        fingerprint_changes=_fingerprint_changes(archived, replayed),
    )


def _differences(one: BundleReader, other: BundleReader) -> dict[str, float]:
    steps = min(one.length, other.length)
    differences = {"steps": float(abs(one.length - other.length))}
    for name in ("poses", "actions_continuous", "actions_tokens"):
        a, b = (getattr(reader.arrays, name)[:steps].astype(np.float64) for reader in (one, other))
        differences[name] = float(np.abs(a - b).max())
    ours, theirs = one.meta.sensor_digests, other.meta.sensor_digests
    differences |= {f"sensor {name} differs": 1.0 for name in ours if theirs.get(name) != ours[name]}
    if not (one.has_frames and other.has_frames):  # a recording of states has only the digests of sampled frames
        pairs = zip(one.meta.frame_digests, other.meta.frame_digests, strict=False)
        return differences | {"differing sampled frames": float(sum(a != b for a, b in pairs))}
    for name in ("rgb", "depth", "ids"):
        differences[name] = max(
            float(np.abs(getattr(one, name)(t).astype(np.float64) - getattr(other, name)(t)).max())
            for t in range(steps)
        )
    return differences


def _fingerprint_changes(one: BundleReader, other: BundleReader) -> dict[str, tuple[str, str]]:
    a, b = (
        {**mark.software, "renderer": mark.renderer, "cpu": mark.cpu}
        for mark in (one.meta.provenance.fingerprint, other.meta.provenance.fingerprint)
    )
    return {key: (a.get(key, "-"), b.get(key, "-")) for key in sorted({*a, *b}) if a.get(key) != b.get(key)}
