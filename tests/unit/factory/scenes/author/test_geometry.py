"""Building blocks: solids are closed and wound outwards, texture coordinates follow metres."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.author.catalogue import CATALOGUE, Workshop
from factory.scenes.author.geometry import (
    Mesh,
    block,
    card,
    cushion,
    cylinder,
    fitted_block,
    lathe,
    merge,
    moved,
    rod,
    tube,
)
from factory.scenes.author.materials import linear_rgb

SOLIDS = {
    "block": (block((0, 0, 0), (1, 2, 3)), 6.0),
    "fitted_block": (fitted_block((0, 0, 0), (1, 2, 3)), 6.0),
    "cushion": (cushion((0, 0, 0), (1, 1, 1), 0.1), 0.94),
    "cylinder": (cylinder(1.0, 0.0, 1.0, sides=64), 3.13),
    "lathe": (lathe([(1.0, 0.0), (0.5, 1.0)], sides=64), 1.83),
    "rod": (rod((0, 0, 0), (0, 1, 1), 0.5, 64), 1.11),
    "bent tube": (tube([(0, 0, 0), (0, 1, 0), (1, 1, 0)], 0.1, 32), 0.0533),
    "turned block": (moved(block((0, 0, 0), (1, 2, 3)), (5, 5, 5), 0.3, 0.4, 0.5), 6.0),
}


def signed_volume(mesh: Mesh) -> float:
    total, start = 0.0, 0
    for count in mesh.counts:
        corners = mesh.points[mesh.indices[start : start + count]]
        for k in range(1, count - 1):
            total += float(np.dot(corners[0], np.cross(corners[k], corners[k + 1]))) / 6
        start += count
    return total


@pytest.mark.parametrize("name", SOLIDS)
def test_solid_is_closed_and_wound_outwards(name: str) -> None:
    mesh, volume = SOLIDS[name]
    assert signed_volume(mesh) == pytest.approx(volume, rel=0.03)
    edges: set[tuple[int, int]] = set()
    start = 0
    for count in mesh.counts:
        face = mesh.indices[start : start + count].tolist()
        edges.update(zip(face, face[1:] + face[:1], strict=True))
        start += count
    assert all((b, a) in edges for a, b in edges)


def test_card_is_seen_from_both_sides() -> None:
    leaf = card([(0, 0, 0), (1, 0, 0), (1, 1, 0)])
    assert leaf.counts.tolist() == [3, 3]
    assert leaf.indices.tolist() == [0, 1, 2, 2, 1, 0]


def test_projected_texture_coordinates_are_metres_over_the_tile_size() -> None:
    joined = merge([block((0, 0, 0), (1, 2, 3)), block((4, 0, 0), (5, 1, 1))], tile_m=0.5)
    assert joined.st is not None
    assert joined.st.shape == (48, 2)
    assert np.ptp(joined.st[:24, 1]) == pytest.approx(6.0)


def test_colours_become_linear_as_usd_wants_them() -> None:
    assert linear_rgb("#ffffff") == (1.0, 1.0, 1.0)
    assert linear_rgb("#808080")[0] == pytest.approx(0.2159, abs=1e-3)


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name.startswith(("SM_Chair", "SM_Sofa", "SM_Table"))])
def test_furniture_is_wound_outwards(name: str) -> None:
    pieces = Workshop(0).model(name, 0).pieces
    assert sum(signed_volume(piece.mesh) for piece in pieces) > 0


@pytest.mark.parametrize("bevel", [0.005, 0.01, 0.015, 0.019])
def test_the_chamfers_of_a_thin_board_never_cross(bevel: float) -> None:
    mesh = cushion((-0.5, -0.02, 0.0), (0.5, 0.02, 0.8), bevel)
    middle, start = np.array((0.0, 0.0, 0.4)), 0
    for count in mesh.counts:
        corners = mesh.points[mesh.indices[start : start + count]]
        normal = np.cross(np.roll(corners, -1, axis=0) - corners, np.roll(corners, -2, axis=0) - corners).sum(axis=0)
        assert normal @ (corners.mean(axis=0) - middle) >= -1e-12
        start += count
