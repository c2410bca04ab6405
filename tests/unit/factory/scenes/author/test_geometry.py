"""Building blocks: solids are closed and wound outwards, texture coordinates follow metres."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.author.geometry import (
    AuthoredMesh,
    block,
    card,
    cushion,
    cylinder,
    fitted_block,
    lathe,
    merge,
    moved,
    open_block,
    rod,
    tube,
    uncapped,
)
from factory.scenes.author.materials import linear_rgb
from factory.scenes.author.props.catalogue import CATALOGUE, PropBuilder

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


def signed_volume(mesh: AuthoredMesh) -> float:
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


def test_an_open_block_has_only_the_named_faces() -> None:
    outwards = {"S": (0, -1, 0), "E": (1, 0, 0), "N": (0, 1, 0), "W": (-1, 0, 0), "B": (0, 0, -1), "T": (0, 0, 1)}
    for name, direction in outwards.items():
        face = open_block((0, 0, 0), (1, 2, 3), name)
        a, b, c, _ = face.points[face.indices]
        normal = np.cross(b - a, c - b)
        assert normal / np.linalg.norm(normal) == pytest.approx(direction)
    whole = open_block((0, 0, 0), (1, 2, 3), "SENWBT", fitted=True)
    assert signed_volume(whole) == pytest.approx(6.0)
    assert whole.st is not None
    assert len(whole.st) == 24


def test_an_uncapped_rod_lacks_only_its_two_ends() -> None:
    rod_mesh = rod((0, 0, 0), (0, 0, 1), 0.1, 5)
    open_rod = uncapped(rod_mesh)
    assert open_rod.counts.tolist() == [4] * 5
    assert open_rod.indices.tolist() == rod_mesh.indices[:20].tolist()


def test_card_is_seen_from_both_sides() -> None:
    leaf = card([(0, 0, 0), (1, 0, 0), (1, 1, 0)])
    assert leaf.counts.tolist() == [3, 3]
    assert leaf.indices.tolist() == [0, 1, 2, 2, 1, 0]


def test_projected_texture_coordinates_are_metres_divided_by_the_tile_size() -> None:
    joined = merge([block((0, 0, 0), (1, 2, 3)), block((4, 0, 0), (5, 1, 1))], tile_m=0.5)
    assert joined.st is not None
    assert joined.st.shape == (48, 2)
    assert np.ptp(joined.st[:24, 1]) == pytest.approx(6.0)


def test_colours_become_linear_as_usd_requires() -> None:
    assert linear_rgb("#ffffff") == (1.0, 1.0, 1.0)
    assert linear_rgb("#808080")[0] == pytest.approx(0.2159, abs=1e-3)


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name.startswith(("SM_Chair", "SM_Sofa", "SM_Table"))])
def test_furniture_is_wound_outwards(name: str) -> None:
    pieces = PropBuilder(0).model(name, 0).pieces
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
