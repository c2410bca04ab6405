"""Draws contact sheets of labelled targets: each variant of each category in isolation, or chosen targets in place.

Pure functions select the targets. Does not write files.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from factory.scenes.pictures.viewpoints import Viewpoint, looking
from schemas.frame import Frame
from schemas.scene import CompiledScene, Target
from workers.geometry.grid import Grid
from workers.render import Renderer

_MOST_A_CATEGORY = 12
_TILE_PX, _TEXT_PX = 200, 34
_BACKGROUND = (236, 236, 232)
_FOV_DEG, _DOWN_RAD, _ASIDE_RAD = 34.0, math.radians(-16.0), math.radians(28.0)
_ROOM = 1.12
_OPEN_SIDE_WORTH = 1.4
_TURNS_DEG = (0, 40, -40, 80, -80, 140, -140, 180)
_IN_PLACE_FOV_DEG, _IN_PLACE_EYE_M = 60.0, 0.9
_NUMBER = re.compile(r"_\d+$")

Picture = NDArray[np.uint8]


def model_name(prim_path: str) -> str:
    """Returns the prim name without its instance number: `SM_Chair_A_02` for `/World/Props/SM_Chair_A_02_17`."""
    return _NUMBER.sub("", prim_path.rpartition("/")[2])


def variants(targets: Sequence[Target], most: int = _MOST_A_CATEGORY) -> list[Target]:
    """Returns one target per model and colour, at most `most` per category, sorted by category and model."""
    first: dict[tuple[str, str, str], Target] = {}
    for target in targets:
        first.setdefault((target.category, model_name(target.prim_path), target.colour), target)
    kept: list[Target] = []
    for category in sorted({key[0] for key in first}):
        kept += [first[key] for key in sorted(first) if key[0] == category][:most]
    return kept


def known_colours(targets: Sequence[Target], count: int, rng: Generator) -> list[Target]:
    """Returns a random sample of the targets with a known colour, in their original order."""
    known = [target for target in targets if target.colour != "unknown"]
    rows = rng.choice(len(known), min(count, len(known)), replace=False) if known else np.zeros(0, np.int64)
    return [known[row] for row in sorted(rows.tolist())]


def alone(scene: CompiledScene, instance_id: int) -> CompiledScene:
    """Returns the scene with one visible instance and unchanged light."""
    parts = np.flatnonzero(scene.part_instance == instance_id)
    runs = [np.arange(scene.part_first[p], scene.part_first[p] + scene.part_count[p]) for p in parts]
    rows = np.concatenate(runs) if runs else np.zeros(0, np.int64)
    counts = scene.part_count[parts]
    layers, texture = np.unique(np.maximum(scene.part_texture[parts], 0), return_inverse=True)
    return replace(
        scene,
        positions=scene.positions[rows],
        uvs=scene.uvs[rows],
        colours=scene.colours[rows],
        light_uvs=scene.light_uvs[rows] if len(scene.light_uvs) else scene.light_uvs,
        part_first=(np.cumsum(counts) - counts).astype(np.int32),
        part_count=counts,
        part_instance=scene.part_instance[parts],
        part_texture=np.where(scene.part_texture[parts] < 0, -1, texture).astype(np.int16),
        textures=tuple(scene.textures[layer] for layer in layers) if scene.textures else (),
        masks={place: scene.masks[layer] for place, layer in enumerate(layers.tolist()) if layer in scene.masks},
    )


def facing(scene: CompiledScene, target: Target) -> float:
    """Returns the heading, radians, from a target to the side on which most of the nearby connected floor is."""
    grid = Grid.from_scene(scene)
    floor = grid.centre_of(np.argwhere(scene.reachable > 0))
    away = floor - np.array(target.centroid_m[:2])
    distance = np.linalg.norm(away, axis=1)
    reach = max(target.size_m[:2]) / 2
    near = (distance > 0.05) & (distance < distance.min(initial=np.inf) + reach + 0.6)
    if not near.any():
        return 0.0
    pull = (away[near] / distance[near, None] ** 2).sum(axis=0)
    return math.atan2(pull[1], pull[0])


def _view_alone(scene: CompiledScene, target: Target) -> Viewpoint:
    """Returns a viewpoint obliquely in front of the open side of the target and slightly above, from which the target
    fills the frame."""
    yaw = facing(scene, target) + _ASIDE_RAD
    radius = float(np.linalg.norm(target.size_m)) / 2
    way = _ROOM * radius / math.sin(math.radians(_FOV_DEG) / 2)
    centre = np.array(target.centroid_m)
    out = np.array((math.cos(yaw) * math.cos(_DOWN_RAD), math.sin(yaw) * math.cos(_DOWN_RAD), -math.sin(_DOWN_RAD)))
    return looking(centre + way * out, yaw + math.pi, _DOWN_RAD, _FOV_DEG)


def _view_in_place(scene: CompiledScene, target: Target, yaw: float) -> Viewpoint:
    """Returns a viewpoint in a given direction, slightly above the robot's camera, directed at the target's centre."""
    radius = float(np.linalg.norm(target.size_m)) / 2
    way = min(max(1.3 * radius / math.sin(math.radians(_IN_PLACE_FOV_DEG) / 2), 0.8), 3.0)
    eye = np.array(target.centroid_m) + way * np.array((math.cos(yaw), math.sin(yaw), 0.0))
    eye[2] = scene.info.floor_height_m + _IN_PLACE_EYE_M
    rise = math.atan2(target.centroid_m[2] - eye[2], way)
    return looking(eye, yaw + math.pi, rise, _IN_PLACE_FOV_DEG)


def _tiles(eye: Renderer, scene: CompiledScene, targets: Sequence[Target], in_place: bool) -> Iterator[Picture]:
    for target in targets:
        if in_place:
            frame = _best_in_place(eye, scene, target)
        else:
            view = _view_alone(scene, target)
            eye.load(alone(scene, target.instance_id), view.camera)
            frame = eye.render(view.pose)
        rgb = frame.rgb if in_place else np.where(frame.ids[..., None] == 0, np.array(_BACKGROUND, np.uint8), frame.rgb)
        if in_place:
            rgb = _outlined(rgb, frame.ids == target.instance_id)
        yield np.asarray(Image.fromarray(rgb).resize((_TILE_PX, _TILE_PX), Image.Resampling.LANCZOS))


def _best_in_place(eye: Renderer, scene: CompiledScene, target: Target) -> Frame:
    """Renders views from all around, and returns the one with the most pixels of the target; prefers the open side."""
    looks: list[Frame] = []
    for turn in _TURNS_DEG:
        view = _view_in_place(scene, target, facing(scene, target) + math.radians(turn))
        eye.load(scene, view.camera)
        looks.append(eye.render(view.pose))
    shown = np.array([float((look.ids == target.instance_id).sum()) for look in looks])
    shown[0] *= _OPEN_SIDE_WORTH
    return looks[int(shown.argmax())]


def _outlined(rgb: Picture, mask: NDArray[np.bool_]) -> Picture:
    """Returns the image with the bounding box of the mask drawn on it."""
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return rgb
    image = Image.fromarray(rgb)
    box = (int(columns.min()), int(rows.min()), int(columns.max()), int(rows.max()))
    ImageDraw.Draw(image).rectangle(box, outline=(255, 0, 255), width=3)
    return np.asarray(image)


def draw_sheet(
    eye: Renderer, scene: CompiledScene, targets: Sequence[Target], in_place: bool = False, columns: int = 8
) -> Image.Image:
    """Returns a sheet with one tile per target, labelled with category, colour and prim.

    Args:
        eye: renderer of the tiles; larger frames are downsampled.
        scene: scene of the targets.
        targets: targets to draw.
        in_place: whether to draw each target with its surroundings and its bounding box, instead of isolated.
        columns: number of tiles per row.
    """
    rows = max(1, -(-len(targets) // columns))
    height = _TILE_PX + _TEXT_PX
    sheet = Image.new("RGB", (columns * _TILE_PX, rows * height), _BACKGROUND)
    pen = ImageDraw.Draw(sheet)
    large, small = ImageFont.load_default(14), ImageFont.load_default(11)
    for number, tile in enumerate(_tiles(eye, scene, targets, in_place)):
        x, y = number % columns * _TILE_PX, number // columns * height
        target = targets[number]
        sheet.paste(Image.fromarray(tile), (x, y))
        pen.text((x + 6, y + _TILE_PX), f"{target.category}  {target.colour}", fill=(20, 20, 20), font=large)
        pen.text((x + 6, y + _TILE_PX + 17), target.prim_path.rpartition("/")[2], fill=(90, 90, 90), font=small)
    return sheet
