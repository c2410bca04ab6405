"""Draws the appearance of an episode from ranges: a function of seed, episode and factor, and of the scene.

Pure functions.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

from schemas.appearance import Appearance, DrawnAppearance, LampLight, LightMix, LightRanges
from schemas.appearance.light_groups import SCREENS, LightGroups
from schemas.scene import CompiledScene, Target
from schemas.support.numpy_types import Floats
from workers.appearance.cameras import draw_camera
from workers.appearance.clutter import place_clutter
from workers.appearance.factor_stream import Factor, FactorStream
from workers.appearance.materials import SceneSurfaces, draw_materials
from workers.appearance.relight import LAMP_K


@dataclass(frozen=True, eq=False)
class AppearanceScene:
    """Scene with the data from which its appearances are drawn; prepared once for all of its episodes."""

    scene: CompiledScene
    """Compiled scene."""
    light: LightGroups | None = None
    """Light groups of the scene; needed if the light is varied."""

    @functools.cached_property
    def surfaces(self) -> SceneSurfaces:
        return SceneSurfaces.of(self.scene)


def draw_appearance(
    ranges: Appearance, seed: int, episode: int, place: AppearanceScene, target: Target, poses: Floats
) -> DrawnAppearance:
    """Returns the values of all factors of an episode.

    Args:
        ranges: ranges of the factors.
        seed: root seed of the plan.
        episode: number of the episode.
        place: scene of the episode.
        target: target of the episode, which clutter does not hide.
        poses: (T, 7) poses of base_link, from which clutter keeps its distance; metres and a quaternion w, x, y, z.

    Raises:
        ValueError: the light is varied, and `place` has no light groups.
    """

    def stream(factor: Factor) -> FactorStream:
        return FactorStream(seed, episode, factor)

    light, materials, camera, clutter = ranges.light, ranges.materials, ranges.camera, ranges.clutter
    return DrawnAppearance(
        name=ranges.name,
        episode=episode,
        light=None if light is None else _draw_light(light, stream(Factor.LIGHT), place.light),
        materials=()
        if materials is None
        else draw_materials(materials, stream(Factor.SURFACES), stream(Factor.FURNITURE), place.surfaces),
        camera=None if camera is None else draw_camera(camera, stream(Factor.CAMERA)),
        clutter=()
        if clutter is None
        else place_clutter(clutter, stream(Factor.CLUTTER), scene=place.scene, target=target, poses=poses),
    )


def _draw_light(ranges: LightRanges, stream: FactorStream, light: LightGroups | None) -> LightMix:
    """Returns the light of each group. Screens keep their light, and at least one of the other groups is on."""
    if light is None:
        raise ValueError("the light groups of the scene are missing")
    kept = LampLight(gain=1.0, temperature_k=LAMP_K)
    lamps, is_on = [], []
    for group in light.info.groups:
        gain, kelvin = stream.between(ranges.lamps), stream.between(ranges.temperature_k, 0)
        is_on.append(stream.share() >= ranges.off_share)
        lamps.append(kept if group.kind == SCREENS else LampLight(gain=gain, temperature_k=kelvin))
    varied = [number for number, group in enumerate(light.info.groups) if group.kind != SCREENS]
    if varied:
        is_on[stream.choose(varied)] = True
    off = {number for number in varied if not is_on[number]}
    return LightMix(
        lamps=tuple(
            lamp.model_copy(update={"gain": 0.0}) if number in off else lamp for number, lamp in enumerate(lamps)
        ),
        sky=LampLight(gain=stream.between(ranges.sky), temperature_k=stream.between(ranges.sky_temperature_k, 0)),
        adaptation=ranges.adaptation,
    )
