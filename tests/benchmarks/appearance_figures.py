"""Draws the figures of docs/appearance.md: frames of built-in scenes, clean and with each appearance.

`python -m tests.benchmarks.appearance_figures DIR` writes one JPEG for each appearance. Measures nothing.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.dataset.packages import light_file
from factory.scenes.build import build_scene
from factory.support.settings import scene_cache
from schemas.appearance.appearance_file import load_appearance
from schemas.appearance.light_groups import decode_light_groups
from schemas.config import CameraConfig
from schemas.scene import read_scene
from schemas.storage.place import digest_of
from workers.appearance import AppearanceScene, ShiftedRenderer, apply_appearance, draw_appearance
from workers.geometry.pose import Pose
from workers.render import Renderer
from workers.render.choose import open_renderer

_SIZE, _EPISODES = 640, (1, 2, 3, 4)
_SHOWN = 240
"""Side of a frame in the figures, pixels."""
_VIEWS = {"office": (18, -0.7), "hospital": (23, 3.0), "full_warehouse": (60, 2.25)}
"""Scene -> (number of the spawn point, heading in radians) of its frames."""


def main(folder: Path) -> None:
    """Writes the figures."""
    folder.mkdir(parents=True, exist_ok=True)
    rows: dict[str, list[NDArray[np.uint8]]] = {
        name: [] for name in ("light", "materials", "camera", "clutter", "full")
    }
    with open_renderer("gl", _SIZE) as renderer:
        for scene, (spawn, yaw) in _VIEWS.items():
            place = _place(scene)
            x, y = place.scene.spawns[spawn]
            pose = Pose.planar(float(x), float(y), yaw, z=place.scene.info.floor_height_m)
            for name, row in rows.items():
                row.append(_row(renderer, place, pose, name))
    for name, row in rows.items():
        Image.fromarray(np.vstack(row)).save(folder / f"{name}.jpg", quality=82)


def _place(name: str) -> AppearanceScene:
    package = build_scene(name, 0, scene_cache())
    with light_file(package, digest_of(package)).open("rb") as light:
        return AppearanceScene(read_scene(package), decode_light_groups(light))


def _row(renderer: Renderer, place: AppearanceScene, pose: Pose, name: str) -> NDArray[np.uint8]:
    """Returns the clean frame and the frames of four episodes with an appearance, side by side."""
    poses = np.array(((pose.x, pose.y, pose.z, pose.qw, pose.qx, pose.qy, pose.qz),))
    camera = CameraConfig()
    renderer.load(place.scene, camera)
    images = [renderer.render(pose).rgb]
    for episode in _EPISODES:
        drawn = draw_appearance(load_appearance(name), 7, episode, place, place.scene.info.targets[0], poses)
        renderer.load(apply_appearance(place.scene, place.light, drawn), camera)
        seen = renderer if drawn.camera is None else ShiftedRenderer(renderer, camera, drawn.camera, _SIZE)
        images.append(seen.render(pose).rgb)
    small = [np.asarray(Image.fromarray(image).resize((_SHOWN, _SHOWN), Image.Resampling.LANCZOS)) for image in images]
    return np.hstack(small)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
