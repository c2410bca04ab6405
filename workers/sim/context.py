"""State that a simulation process keeps between jobs: the renderer, loaded scenes, versions of software and machine.

It is a cache only: the result of an attempt does not depend on earlier attempts.
"""

from __future__ import annotations

import functools
import platform
from collections import OrderedDict
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from schemas.appearance.light_groups import LightGroups, decode_light_groups
from schemas.episode import Fingerprint
from schemas.scene import CompiledScene, read_scene
from schemas.support.closing import Closing
from schemas.support.extras import require_package
from schemas.support.stage_timer import StageTimer, no_stage_timer
from schemas.terms import RendererKind
from workers.appearance import AppearanceScene
from workers.geometry.grid import Grid, body_centre
from workers.physics.world import ColliderMesh
from workers.render import Renderer
from workers.render.choose import open_renderer
from workers.render.prepared_scenes import KEPT_SCENES

if TYPE_CHECKING:
    from schemas.language.scene import SceneLanguage
    from schemas.start_survey import ExchangeSurvey
    from workers.sensors.rays import SceneRays
    from workers.sim.correct import PolicyDriver


_PACKAGES = ("isal", "minivla-factory", "moderngl", "numpy", "pybullet", "zstandard")
_CPU_INFO = Path("/proc/cpuinfo")


def make_fingerprint(renderer: str) -> Fingerprint:
    """Returns the fingerprint of this process.

    Args:
        renderer: description of the renderer in use.
    """
    software = {name: version(name) for name in _PACKAGES}
    software["python"] = platform.python_version()
    # the C library computes sines and cosines, so its version can affect the bytes
    software["libc"] = " ".join(platform.libc_ver()).strip() or "unknown"
    return Fingerprint(software=software, renderer=renderer, cpu=f"{_cpu_model()} ({platform.machine()})")


def _cpu_model() -> str:
    """Returns the processor's model name from `/proc/cpuinfo`, or else from `platform`."""
    if _CPU_INFO.is_file():
        for line in _CPU_INFO.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


@dataclass(frozen=True)
class LoadedScene:
    """Compiled scene with its derived data."""

    compiled: CompiledScene
    """The compiled scene."""
    grid: Grid
    """Occupancy grid of the scene."""
    collider: ColliderMesh
    """Obstacles of the scene for physics."""
    light: LightGroups | None = None
    """Light groups of the scene, if the appearance of its episodes needs them."""

    @functools.cached_property
    def appearance(self) -> AppearanceScene:
        """The scene with its light groups, from which the appearance of an episode is drawn."""
        return AppearanceScene(self.compiled, self.light)

    @functools.cached_property
    def language(self) -> SceneLanguage:
        """Objects of the scene that instructions name."""
        from schemas.language.graph.scene_graph import build_graph
        from schemas.language.scene import SceneLanguage

        return SceneLanguage(build_graph(self.compiled))

    @functools.cached_property
    def exchange(self) -> ExchangeSurvey:
        """Starts of the scene from which several objects could be the target."""
        from schemas.start_survey import ExchangeSurvey

        return ExchangeSurvey(self.compiled, self.language.graph)

    @functools.cached_property
    def rays(self) -> SceneRays:
        """Ray caster for lidars.

        Raises:
            UsageError: embreex is not installed; the message names the extra.
        """
        require_package("embreex", "a lidar")
        from workers.sensors.rays import SceneRays

        return SceneRays(self.compiled)

    def are_connected(self, x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> NDArray[np.bool_]:
        """Returns whether the body centre is on the connected floor at each of the base_link poses."""
        return self.grid.values_at(self.compiled.reachable, body_centre(x, y, yaw), 0).astype(bool)

    @functools.cached_property
    def taken(self) -> NDArray[np.float64]:
        """(K, 2, 2) lower and upper corners x, y of the floor areas that targets cover, metres; no episode starts in
        them, for instance under a shelf."""
        return np.array([target.taken_m for target in self.compiled.info.targets]).reshape(-1, 2, 2)


class SimulationContext(Closing):
    """Renderer with an LRU cache of loaded scenes."""

    def __init__(
        self,
        renderer_kind: RendererKind = "auto",
        timer: StageTimer = no_stage_timer,
        apart: bool = False,
        kept_scenes: int = KEPT_SCENES,
        driver: PolicyDriver | None = None,
    ) -> None:
        """Opens the renderer.

        Args:
            renderer_kind: type of the renderer.
            timer: called at the end of every stage of every attempt.
            apart: whether the renderer runs in a separate process, see `open_renderer`.
            kept_scenes: number of scenes that stay loaded and prepared.
            driver: policy that drives the episodes with corrections; `None` if this process simulates none.
        """
        self.timer, self.driver = timer, driver
        self.renderer: Renderer = open_renderer(renderer_kind, timer=timer, apart=apart, kept_scenes=kept_scenes)
        self._kept_scenes = kept_scenes
        self.fingerprint: Fingerprint = make_fingerprint(self.renderer.description)
        self._loaded: OrderedDict[str, LoadedScene] = OrderedDict()

    def load(self, path: Path, sha256: str, light: Path | None = None) -> LoadedScene:
        """Returns the scene with that digest; reads it from `path` if it is not loaded.

        Args:
            path: package of the scene.
            sha256: digest of the package.
            light: light groups of the scene, if the appearance of its episodes needs them.

        Raises:
            InvalidBundle: the package or the light groups are damaged or have a different format version.
        """
        if sha256 not in self._loaded:
            self.renderer.make_room()
            while len(self._loaded) >= self._kept_scenes:  # scenes are freed before one is read, to limit the memory
                self._loaded.popitem(last=False)
            self._loaded[sha256] = prepare_scene(read_scene(path))
        if light is not None and self._loaded[sha256].light is None:
            with light.open("rb") as file:
                self._loaded[sha256] = replace(self._loaded[sha256], light=decode_light_groups(file))
        self._loaded.move_to_end(sha256)
        return self._loaded[sha256]

    def loaded(self, sha256: str) -> LoadedScene:
        """Returns a loaded scene.

        Raises:
            KeyError: the scene is not loaded.
        """
        return self._loaded[sha256]

    def close(self) -> None:
        self.renderer.close()


def prepare_scene(scene: CompiledScene) -> LoadedScene:
    """Returns a scene with its grid and its collider."""
    return LoadedScene(scene, Grid.from_scene(scene), ColliderMesh.from_scene(scene))
