"""Scenes as binary glTF: two boxes, one plain and one with a texture."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
import trimesh

from factory.export.vlnce.exporter import encode_glb
from tests.builders.scene import Box, build_scene, room_walls

RED = (255, 0, 0)
GREY = (128, 128, 128)
GREY_LINEAR = 0.21586
"""sRGB 128 as a linear value."""


@pytest.fixture(scope="module")
def scene():
    textures = np.random.default_rng(7).integers(0, 256, (1, 512, 512, 3), np.uint8)
    boxes = (
        *room_walls((-2, -2), (2, 2)),
        Box((0, 0, 0), (1, 1, 1), RED, "chair"),
        Box((-1, -1, 0), (-0.5, -0.5, 1), GREY, texture=0),
    )
    return build_scene(boxes, textures=textures)


@pytest.fixture(scope="module")
def meshes(scene):
    """Meshes by name, as trimesh reads the file."""
    return trimesh.load(io.BytesIO(encode_glb(scene)), file_type="glb", process=False).geometry


def vertices_of(scene, layer):
    textures = np.repeat(scene.part_texture, scene.part_count)
    return np.flatnonzero(textures == layer)


@pytest.mark.parametrize(("name", "layer"), [("colours", -1), ("texture_0", 0)])
def test_every_triangle_is_written_in_gltf_axes(scene, meshes, name, layer):
    mesh = meshes[name]
    x, y, z = scene.positions[vertices_of(scene, layer)].T
    np.testing.assert_array_equal(mesh.vertices[mesh.faces.ravel()].astype(np.float32), np.column_stack([x, z, -y]))


def test_a_textured_mesh_has_its_image_and_coordinates(scene, meshes):
    visual = meshes["texture_0"].visual
    np.testing.assert_array_equal(np.asarray(visual.material.baseColorTexture.convert("RGB")), scene.textures[0])
    np.testing.assert_allclose(visual.uv, scene.uvs[vertices_of(scene, 0)], atol=1e-6)


def test_materials_are_unlit_and_vertex_colours_linear_with_16_bits(scene):
    data = encode_glb(scene)
    size = int.from_bytes(data[12:16], "little")
    document, binary = json.loads(data[20 : 20 + size]), data[28 + size :]
    assert all("KHR_materials_unlit" in material["extensions"] for material in document["materials"])
    assert document["extensionsUsed"] == ["KHR_materials_unlit"]
    for mesh, expected in zip(document["meshes"], (None, (GREY_LINEAR,) * 3), strict=True):
        accessor = document["accessors"][mesh["primitives"][0]["attributes"]["COLOR_0"]]
        assert (accessor["componentType"], accessor["normalized"], accessor["type"]) == (5123, True, "VEC4")
        start = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        colours = np.frombuffer(binary, "<u2", accessor["count"] * 4, start).reshape(-1, 4) / 65535
        assert (colours[:, 3] == 1).all()
        if expected:
            np.testing.assert_allclose(colours[:, :3], [expected] * len(colours), atol=1e-4)
        else:
            assert (colours[:, :3] == (1, 0, 0)).all(axis=1).any()


def test_equal_scenes_give_equal_bytes(scene):
    assert encode_glb(scene) == encode_glb(scene)
