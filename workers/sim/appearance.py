"""Draws the appearance of an episode, and loads its changed scene and cameras into a renderer. Renders no frame."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from schemas.appearance import Appearance, CameraChange, DrawnAppearance
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import WorldError
from schemas.job import Job
from schemas.scene import Instance
from workers.appearance import ShiftedRenderer, apply_appearance, draw_appearance
from workers.render import Renderer
from workers.sim.context import LoadedScene


class RenderedScene(NamedTuple):
    """Scene of an episode as it is rendered."""

    scene: LoadedScene
    """Scene with its appearance; the collider is that of the scene without clutter."""
    renderer: Renderer
    """Renderer with that scene loaded; it applies the change of the cameras to the recorded camera."""
    drawn: DrawnAppearance | None = None
    """Factors of the episode; `None` if the appearance is not varied."""

    @property
    def instances(self) -> tuple[Instance, ...]:
        """Instances that the ids refer to, clutter included."""
        return self.scene.compiled.info.instances

    @property
    def change(self) -> CameraChange | None:
        return None if self.drawn is None else self.drawn.camera


def show_appearance(
    job: Job, ranges: Appearance | None, scene: LoadedScene, renderer: Renderer, poses: NDArray[np.float64]
) -> RenderedScene:
    """Draws the appearance of an episode, and loads its scene and camera; without ranges, the scene as it was compiled.

    Args:
        job: job of the episode.
        ranges: ranges of the appearance.
        scene: scene of the job.
        renderer: open renderer.
        poses: (T, 7) poses of base_link, from which clutter keeps its distance.

    Raises:
        WorldError: the light is varied, and the scene has no light groups.
    """
    if ranges is None:
        renderer.load(scene.compiled, job.camera)
        return RenderedScene(scene, renderer)
    if ranges.light is not None and scene.light is None:
        raise WorldError(f"the light groups of scene {job.scene} are missing: run `factory scene light {job.scene}`")
    target = scene.compiled.info.target(job.target_id)
    drawn = draw_appearance(
        ranges, job.root_seed, episode=job.index, place=scene.appearance, target=target, poses=poses
    )
    compiled = apply_appearance(scene.compiled, scene.light, drawn) if drawn.changes_scene else scene.compiled
    renderer.load(compiled, job.camera)
    if drawn.camera is not None:
        renderer = ShiftedRenderer(renderer, job.camera, drawn.camera, FRAME_SIZE_PX)
    return RenderedScene(replace(scene, compiled=compiled), renderer, drawn)
