"""Materials of objects by the names of their surfaces and the areas of their parts."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.compile.surfaces import UNKNOWN, materials_of, substance_of
from factory.scenes.importer import Part, Surface


def part(path: str, area_m2: float, surface: Surface) -> Part:
    """Returns a part that is one triangle with a given area."""
    triangle = np.array([[(0.0, 0.0, 0.0), (2 * area_m2, 0.0, 0.0), (0.0, 1.0, 0.0)]])
    return Part(path, triangle, None, None, surface)


@pytest.mark.parametrize(
    ("name", "texture", "substance"),
    [
        ("M_WoodOakTint", "", "wood"),
        ("Mat_Dark_Walnut_02", "", "wood"),
        ("StainlessSteel", "", "metal"),
        ("Material.001", "/maps/oak_veneer_diffuse.jpg", "wood"),
        ("Material.001", "C:\\maps\\MarbleTile.png", "stone"),
        ("Material.001", "C:\\maps\\GraniteSlab.png", "stone"),
        ("FabricRed", "", "fabric"),
        ("MetalOnGlass", "", UNKNOWN),
        ("FauxLeather", "", UNKNOWN),
        ("SpinesLeather", "", UNKNOWN),
        ("Silver", "", UNKNOWN),
        ("Woodstock", "", UNKNOWN),
        ("", "", UNKNOWN),
    ],
)
def test_a_name_gives_a_substance_only_if_it_names_exactly_one_material(name, texture, substance):
    assert substance_of(Surface(name=name, texture=texture)) == substance


def test_a_surface_marked_as_metal_is_metal_unless_its_name_contains_another_substance():
    assert substance_of(Surface(name="Grey_r35m1", is_metal=True)) == "metal"
    assert substance_of(Surface(name="LeatherCoated", is_metal=True)) == "leather"


@pytest.mark.parametrize(
    ("wood", "metal", "paint", "materials"),
    [
        (6.0, 3.0, 1.0, ("wood", "metal", "unknown")),
        (9.8, 0.1, 0.1, ("wood",)),
        (5.0, 4.0, 1.0, ()),
        (1.0, 1.0, 8.0, ()),
        (2.0, 8.0, 0.0, ("metal", "wood")),
    ],
)
def test_an_object_has_the_material_that_covers_most_of_it_and_lists_the_others_that_are_visible(
    wood, metal, paint, materials
):
    surfaces = {"Oak": wood, "Steel": metal, "White": paint}
    parts = [part(f"/World/T/{name}", area, Surface(name=name)) for name, area in surfaces.items() if area]
    found = materials_of(parts, ["/World/T"] * len(parts))
    assert found == ({"/World/T": materials} if materials else {})
