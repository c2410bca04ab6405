"""Floor plans of the built-in families, generated once in a session, and the boxes of their pieces."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from factory.scenes.author.placement import FloorPlan, PropPlacement
from factory.scenes.author.scene import BUILTIN_SCENES, lay_out_scene
from schemas.errors import WorldError
from schemas.support.numpy_types import Floats
from tests.builders.shared import build_once

FAMILIES = tuple(BUILTIN_SCENES)
SEEDS = range(6)
_FILE = "layout.pickle"


class Layouts:
    """Layouts by family and seed, shared by the processes of a session; each process reads its own copies.

    Args:
        folder: existing folder for the stored layouts.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[tuple[str, int], FloorPlan | None] = {}

    def __getitem__(self, key: tuple[str, int]) -> FloorPlan | None:
        """Returns the layout of a family and a seed; `None` if the seed has none."""
        if key not in self._read:
            stored = build_once(self._folder / f"{key[0]}-{key[1]}", lambda folder: _store(folder, *key))
            self._read[key] = pickle.loads((stored / _FILE).read_bytes())
        return self._read[key]

    def of(self, name: str) -> dict[int, FloorPlan]:
        """Returns the layouts of a family by their seeds."""
        return {seed: plan for seed in SEEDS if (plan := self[name, seed]) is not None}


def _store(folder: Path, name: str, seed: int) -> None:
    try:
        plan = lay_out_scene(BUILTIN_SCENES[name], seed)
    except WorldError:
        plan = None
    folder.mkdir()
    (folder / _FILE).write_bytes(pickle.dumps(plan))


def piece_boxes(plan: FloorPlan) -> Floats:
    """Returns the (N, 2, 3) corners of all pieces in the world, metres."""
    boxes = [piece.mesh.points for structure in plan.structures for piece in structure.pieces]
    for placement in plan.placements:
        boxes += list(world_points(placement))
    return np.array([[points.min(axis=0), points.max(axis=0)] for points in boxes])


def wall_boxes(plan: FloorPlan) -> Floats:
    """Returns the (N, 2, 3) corners of the pieces of the walls, metres."""
    walls = [structure for structure in plan.structures if structure.name.startswith("SM_Wall")]
    points = [piece.mesh.points for wall in walls for piece in wall.pieces]
    return np.array([[each.min(axis=0), each.max(axis=0)] for each in points])


def world_points(placement: PropPlacement) -> tuple[Floats, ...]:
    """Returns the points of each piece of a prop in the world, metres."""
    cos, sin = np.cos(placement.yaw), np.sin(placement.yaw)
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    place = np.array([placement.x, placement.y, placement.z])
    return tuple(piece.mesh.points @ turn + place for piece in placement.model.pieces)
