"""Renders frames of an episode again and compares them with the recorded digests. Changes no files."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coordinator.validation.rollout import arrival_findings, visibility_findings
from coordinator.validation.start import start_findings
from factory.dataset.bundle import EpisodeBundle
from factory.dataset.shared_renderer import shared_renderer
from schemas.encoding.digest import frame_digest
from schemas.terms import Recording
from workers.render import RenderedFrame


def compare_rendered(bundle: EpisodeBundle) -> list[str]:
    """Renders every frame with a recorded digest and returns the findings.

    A finding about digests has the number of differing frames and both renderers; if frames are stored, also how far
    colour, depth and ids differ: largest difference, share of the values, and mean difference of the differing frames.

    Raises:
        WorldError: this machine cannot render.
        ArchiveCorrupt: the scene package is missing or was changed.
    """
    job, digests = bundle.meta.job, bundle.meta.frame_digests
    steps = range(bundle.length) if job.record is Recording.FRAMES else job.sampled_steps(bundle.length)
    found: list[str] = []
    differing: list[int] = []
    target_pixels: dict[int, int] = {}
    distances = {name: _Distance() for name in ("rgb", "depth", "ids")}
    for t, recorded in zip(steps, digests, strict=False):  # a wrong number of digests is another finding
        frame = bundle.render(t)
        if t == 0 and not bundle.has_frames:  # the validator has checked stored frames
            found += start_findings(bundle.meta, bundle.arrays, frame.ids)
        target_pixels[t] = int(np.count_nonzero(frame.ids == bundle.meta.target_instance_id))
        if frame_digest(frame.rgb, frame.depth, frame.ids) != recorded:
            differing.append(t)
            if bundle.has_frames:
                _add_distances(distances, bundle, t, frame)
    found += visibility_findings(bundle.meta, target_pixels)
    if not bundle.has_frames and bundle.length - 1 in target_pixels:
        found += arrival_findings(bundle.meta, target_pixels[bundle.length - 1])
    return [*found, _digest_finding(bundle, differing, distances)] if differing else found


def _digest_finding(bundle: EpisodeBundle, differing: list[int], distances: dict[str, _Distance]) -> str:
    text = (
        f"{len(differing)} of {len(bundle.meta.frame_digests)} frames differ when they are rendered again, first frame "
        f"{differing[0]}; recorded with {bundle.meta.provenance.fingerprint.renderer}, rendered with "
        f"{shared_renderer().description}"
    )
    return "; ".join([text, *(f"{name}: {far}" for name, far in distances.items() if bundle.has_frames)])


def _add_distances(distances: dict[str, _Distance], bundle: EpisodeBundle, t: int, frame: RenderedFrame) -> None:
    distances["rgb"].add(bundle.rgb(t), frame.rgb)
    distances["depth"].add(bundle.depth(t), frame.depth)
    distances["ids"].add(bundle.ids(t), frame.ids)


class _Distance:
    """Distance between recorded and rendered images of one modality."""

    def __init__(self) -> None:
        self._largest = self._sum = 0.0
        self._unequal = self._values = 0

    def add(self, recorded: NDArray[np.generic], rendered: NDArray[np.generic]) -> None:
        apart = np.abs(recorded.astype(np.float64) - rendered.astype(np.float64))
        self._largest = max(self._largest, float(apart.max()))
        self._sum += float(apart.sum())
        self._unequal += int(np.count_nonzero(apart))
        self._values += apart.size

    def __str__(self) -> str:
        share, mean = 100 * self._unequal / self._values, self._sum / self._values
        return f"largest difference {self._largest:.4g}, {share:.3g} % of the values, mean {mean:.3g}"
