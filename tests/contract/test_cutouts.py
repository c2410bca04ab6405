"""Holes of textures: every renderer omits them in colour, depth and ids."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.errors import InvalidBundle
from schemas.scene import (
    CUTOUT_FORMAT,
    SCENE_FORMAT,
    TEXTURE_SIZE_PX,
    CompiledScene,
    decode_geometry,
    decode_scene,
    encode_layout,
    encode_scene,
)
from schemas.scene.package import read_scene_info
from tests.builders.scene import Box, build_scene
from workers.geometry.pose import Pose
from workers.render import Renderer
from workers.render.choose import open_renderer
from workers.render.gl import GlRenderer
from workers.render.tiny import cut_holes

CAMERA = CameraConfig()
ORIGIN = Pose.planar(0.0, 0.0, 0.0)
RED, BLUE, GREEN = (200, 30, 30), (30, 30, 200), (20, 180, 20)


def discs() -> NDArray[np.uint8]:
    """A mask with one disc of half the width of the texture."""
    place = (np.arange(TEXTURE_SIZE_PX) + 0.5) / TEXTURE_SIZE_PX - 0.5
    return np.where(np.hypot(place[:, None], place) < 0.25, 255, 0).astype(np.uint8)


def leaves_before_a_box(mask: NDArray[np.uint8] | None = None) -> CompiledScene:
    """A wall-sized card of leaves, one per square metre, before a blue box and a red wall; a green box in front."""
    texture = np.full((1, TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3), 200, np.uint8)
    boxes = (
        Box((2.0, -4.0, -3.0), (2.001, 4.0, 5.0), (255, 255, 255), texture=0),
        Box((3.0, -0.4, 0.0), (3.5, 0.4, 0.6), BLUE, category="crate"),
        Box((5.0, -40.0, -40.0), (5.1, 40.0, 40.0), RED),
        Box((1.2, 0.5, 0.2), (1.3, 0.7, 0.4), GREEN),
    )
    scene = build_scene(boxes, textures=texture)
    return replace(scene, masks={0: discs() if mask is None else mask})


def expected_ids(frame_ids: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Returns which pixels (H, W) see a leaf of the card, by the geometry of the camera."""
    height, width = frame_ids.shape
    depth = 2.0 - CAMERA.x_m
    rows, columns = (np.arange(size) + 0.5 for size in (height, width))
    reach = np.tan(np.radians(CAMERA.fov_deg) / 2)
    y = CAMERA.y_m - (2 * columns / width - 1) * reach * depth
    z = CAMERA.z_m - (2 * rows / height - 1) * reach * depth
    return np.hypot((y % 1.0) - 0.5, (z % 1.0)[:, None] - 0.5) < 0.25


def test_holes_show_what_is_behind_in_colour_depth_and_ids(renderer: Renderer) -> None:
    renderer.load(leaves_before_a_box(), CAMERA)
    frame = renderer.render(ORIGIN)
    in_front = frame.ids == 4
    assert in_front.any()
    expected = expected_ids(frame.ids) & ~in_front
    assert ((frame.ids == 1) == expected).mean() > 0.985
    assert {2, 3} <= set(np.unique(frame.ids).tolist())
    leaf, wall = (frame.ids == 1), (frame.ids == 3)
    assert frame.depth[leaf] == pytest.approx(2.0 - CAMERA.x_m, abs=2e-3)
    assert frame.depth[wall] == pytest.approx(5.0 - CAMERA.x_m, abs=5e-3)
    assert (np.abs(frame.rgb[wall].astype(int) - RED) <= 2).all()
    assert (np.abs(frame.rgb[leaf].astype(int) - 200) <= 2).all()


def test_depth_and_ids_alone_equal_those_of_the_frame(renderer: Renderer) -> None:
    renderer.load(leaves_before_a_box(), CAMERA)
    for yaw in (0.0, 0.3, -0.7):
        pose = Pose.planar(0.1, -0.2, yaw)
        frame, bare = renderer.render(pose), renderer.render_depth_and_ids(pose)
        assert np.array_equal(frame.depth, bare.depth)
        assert np.array_equal(frame.ids, bare.ids)


@pytest.mark.gl
def test_one_instance_behind_leaves_has_the_pixels_of_the_whole_image() -> None:
    with GlRenderer() as renderer:
        renderer.load(leaves_before_a_box(), CAMERA)
        frame = renderer.render(ORIGIN)
        window, seen = renderer.render_instance(ORIGIN, 2)
    inside = np.s_[window.top : window.bottom, window.left : window.right]
    assert np.array_equal(seen.ids == 2, frame.ids[inside] == 2)
    assert (frame.ids == 2).sum() == (seen.ids == 2).sum() > 0


@pytest.mark.gl
def test_a_scene_keeps_its_pixels_beside_one_with_holes() -> None:
    solid = replace(leaves_before_a_box(), masks={})
    with GlRenderer() as renderer:
        renderer.load(solid, CAMERA)
        before = renderer.render(ORIGIN)
        renderer.load(leaves_before_a_box(), CAMERA)
        renderer.render(ORIGIN)
        renderer.load(solid, CAMERA)
        after = renderer.render(ORIGIN)
    assert np.array_equal(before.rgb, after.rgb)
    assert np.array_equal(before.ids, after.ids)
    assert (before.ids[~(before.ids == 4)] == 1).all()


@pytest.mark.gl
def test_a_full_mask_gives_the_pixels_of_a_scene_without_masks() -> None:
    full = np.full((TEXTURE_SIZE_PX, TEXTURE_SIZE_PX), 255, np.uint8)
    with GlRenderer() as renderer:
        renderer.load(leaves_before_a_box(full), CAMERA)
        masked = renderer.render(ORIGIN)
        renderer.load(replace(leaves_before_a_box(), masks={}), CAMERA)
        plain = renderer.render(ORIGIN)
    assert np.array_equal(masked.rgb, plain.rgb)
    assert np.array_equal(masked.depth, plain.depth)
    assert np.array_equal(masked.ids, plain.ids)


@pytest.mark.gl
def test_a_renderer_in_another_process_has_the_same_holes() -> None:
    scene = leaves_before_a_box()
    with GlRenderer() as here, open_renderer("gl", apart=True) as apart:
        here.load(scene, CAMERA)
        apart.load(scene, CAMERA)
        assert np.array_equal(here.render(ORIGIN).ids, apart.render(ORIGIN).ids)


def test_a_package_stores_its_masks_and_former_readers_refuse_it() -> None:
    scene = leaves_before_a_box()
    data = encode_scene(scene)
    again = decode_scene(io.BytesIO(data))
    assert again.info.format == CUTOUT_FORMAT == 5
    assert list(again.masks) == [0]
    assert np.array_equal(again.masks[0], scene.masks[0])
    assert encode_scene(again) == data
    assert not decode_geometry(io.BytesIO(data)).masks
    plain = encode_scene(replace(scene, masks={}))
    assert read_scene_info(io.BytesIO(plain)).format == SCENE_FORMAT


def test_masks_of_layers_that_do_not_exist_are_refused() -> None:
    data = encode_scene(replace(leaves_before_a_box(), masks={3: discs()}))
    with pytest.raises(InvalidBundle, match="masks belong to existing texture layers"):
        decode_scene(io.BytesIO(data))


def test_a_layout_cannot_store_masks() -> None:
    with pytest.raises(ValueError, match="has masks, which a package of format 4 cannot store"):
        encode_layout(leaves_before_a_box())


def test_small_triangles_cover_the_area_of_the_mask() -> None:
    square = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 0, 0), (2, 2, 0), (0, 2, 0)], np.float32)
    positions, uvs = cut_holes(square, square[:, :2] / 2, discs())
    corners = positions.reshape(-1, 3, 3)
    sides = corners[:, 1:] - corners[:, :1]
    area = np.abs(np.cross(sides[:, 0], sides[:, 1])[:, 2]).sum() / 2
    assert area == pytest.approx(np.pi * 0.25, rel=0.05)
    assert len(uvs) == len(positions)
