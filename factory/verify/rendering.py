"""Renders frames of an episode again and compares them with the recorded digests. Changes no files."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from factory.dataset.bundle import EpisodeBundle
from factory.dataset.shared_renderer import shared_renderer
from schemas.encoding.digest import frame_digest
from schemas.terms import Recording
from workers.render import RenderedFrame


def compare_rendered(bundle: EpisodeBundle) -> list[str]:
    """Renders every frame with a recorded digest; returns one finding if any differs, else an empty list.

    The finding has the number of differing frames and both renderers; if frames are stored, also how far colour, depth
    and ids differ: largest difference, share of the pixels, and mean difference of the differing frames.

    Raises:
        WorldError: this machine cannot render.
        ArchiveCorrupt: the scene package is missing or was changed.
    """
    job, digests = bundle.meta.job, bundle.meta.frame_digests
    steps = range(bundle.length) if job.record is Recording.FRAMES else job.sampled_steps(bundle.length)
    differing: list[int] = []
    distances = {name: _Distance() for name in ("rgb", "depth", "ids")}
    for t, recorded in zip(steps, digests, strict=False):  # a wrong number of digests is another finding
        frame = bundle.render(t)
        if frame_digest(frame.rgb, frame.depth, frame.ids) != recorded:
            differing.append(t)
            if bundle.has_frames:
                _add_distances(distances, bundle, t, frame)
    if not differing:
        return []
    text = (
        f"{len(differing)} of {len(digests)} frames differ when they are rendered again, first frame {differing[0]}; "
        f"recorded with {bundle.meta.provenance.fingerprint.renderer}, rendered with {shared_renderer().description}"
    )
    return [f"{text}; {'; '.join(f'{name}: {far}' for name, far in distances.items())}" if bundle.has_frames else text]


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
