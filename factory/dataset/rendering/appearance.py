"""Appearance of an episode that is read: draws its factors, and gives its scene to renderers. Renders nothing."""

from __future__ import annotations

import functools
import hashlib
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.dataset.packages import ScenePackage
from schemas.appearance import Appearance, DrawnAppearance
from schemas.job import Job
from schemas.scene import CompiledScene, encode_scene
from workers.appearance import apply_appearance, draw_appearance

if TYPE_CHECKING:
    from workers.sensors.rays import SceneRays


class AppearancePackage(NamedTuple):
    """Scene of an episode with its appearance, as a package for a renderer."""

    package: ScenePackage
    """Scene of the episode."""
    drawn: DrawnAppearance
    """Factors of the episode."""

    @property
    def sha256(self) -> str:
        """Key of the scene with its appearance; equal keys give equal images."""
        factors = self.drawn.model_dump_json(exclude={"name", "episode"}).encode()
        return hashlib.sha256(self.package.sha256.encode() + factors).hexdigest()

    def scene(self) -> CompiledScene:
        """Returns the scene with the appearance; raises the errors of `ScenePackage.appearance_scene`."""
        place = self.package.appearance_scene(self.drawn.light is not None)
        return apply_appearance(place.scene, place.light, self.drawn)

    def read(self) -> bytes:
        """Returns the scene as a package."""
        return encode_scene(self.scene(), level=1)

    def rays(self) -> SceneRays:
        """Returns the ray caster of the scene, which hits the clutter, too."""
        return _rays_of(self) if self.drawn.clutter else self.package.rays()


@functools.lru_cache(maxsize=2)
def _rays_of(varied: AppearancePackage) -> SceneRays:
    from workers.sensors.rays import SceneRays

    varied.package.rays()  # raises an error if the scene package or embreex is missing
    return SceneRays(varied.scene())


def drawn_for(ranges: Appearance, job: Job, package: ScenePackage, poses: NDArray[np.float64]) -> DrawnAppearance:
    """Returns the factors of an episode; raises the errors of `ScenePackage.appearance_scene`."""
    place = package.appearance_scene(ranges.light is not None)
    return draw_appearance(ranges, job.root_seed, job.index, place, place.scene.info.target(job.target_id), poses)
