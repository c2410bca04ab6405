"""Tests of the texture arrays of scenes on the graphics device."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import moderngl
import numpy as np
import pytest
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.scene import Layer
from tests.builders.scene import Box, build_scene, room_walls
from workers.geometry.pose import Pose
from workers.render.choose import open_renderer
from workers.render.gl import _open_context
from workers.render.gl_textures import TextureStore

pytestmark = pytest.mark.gl

_SIZE_PX = 16
_VERTEX = "#version 450\nin vec2 corner; void main() { gl_Position = vec4(corner, 0, 1); }"
_FRAGMENT = """#version 450
uniform sampler2DArray layers; uniform int layer; uniform int level; out vec4 colour;
void main() { colour = texelFetch(layers, ivec3(ivec2(gl_FragCoord.xy), layer), level); }"""


@pytest.fixture
def context() -> Iterator[moderngl.Context]:
    opened = _open_context()
    with opened:
        yield opened
    opened.release()


def some_layers(count: int) -> list[Layer]:
    rng = np.random.default_rng(5)
    return [rng.integers(0, 256, (_SIZE_PX, _SIZE_PX, 3)).astype(np.uint8) for _ in range(count)]


def texels(context: moderngl.Context, array: moderngl.TextureArray, count: int) -> list[NDArray[np.uint8]]:
    """Returns the texels of each mipmap of each layer."""
    program = context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
    corners = context.buffer(np.array([-1, -1, 1, -1, -1, 1, 1, 1], np.float32).tobytes())
    square = context.vertex_array(program, [(corners, "2f", "corner")])
    found = []
    for layer in range(count):
        for level in range(_SIZE_PX.bit_length()):
            size = _SIZE_PX >> level
            target = context.simple_framebuffer((size, size), 4)
            target.use()
            array.use(0)
            program["layers"], program["layer"], program["level"] = 0, layer, level
            square.render(moderngl.TRIANGLE_STRIP)
            found.append(np.frombuffer(target.read(components=3, alignment=1), np.uint8).reshape(size, size, 3))
    return found


def test_an_array_with_copied_layers_equals_one_with_new_layers(context: moderngl.Context) -> None:
    layers = some_layers(6)
    store, other = TextureStore(context), TextureStore(context)
    kept = store.upload(layers[:4])
    copied, new = store.upload([layers[5], *layers[1:5]]), other.upload([layers[5], *layers[1:5]])
    pairs = zip(texels(context, copied.array, 5), texels(context, new.array, 5), strict=True)
    assert all(np.array_equal(*pair) for pair in pairs)
    assert np.array_equal(texels(context, kept.array, 4)[0], layers[0][::-1])
    assert context.error == "GL_NO_ERROR"


def test_layers_are_not_copied_from_a_released_array(context: moderngl.Context) -> None:
    layers = some_layers(2)
    store = TextureStore(context)
    store.upload(layers).release()
    again = store.upload(layers)
    assert np.array_equal(texels(context, again.array, 2)[0], layers[0][::-1])
    assert context.error == "GL_NO_ERROR"


def test_layers_of_a_scene_that_no_longer_exists_are_uploaded(context: moderngl.Context) -> None:
    store = TextureStore(context)
    store.upload(some_layers(2))  # these layers are freed here, so new layers may get the same `id()`
    layers = [layer // 2 for layer in some_layers(2)]
    assert np.array_equal(texels(context, store.upload(layers).array, 2)[0], layers[0][::-1])


def test_a_frame_does_not_depend_on_the_scenes_rendered_before() -> None:
    board = np.zeros((3, 64, 64, 3), np.uint8)
    board[0, ::8], board[1, :, ::8], board[2, ::4] = 255, 200, 120
    boxes = [Box((2.0, y, 0.0), (2.1, y + 0.9, 2.0), texture=k) for k, y in enumerate((-1.5, -0.5, 0.5))]
    room = build_scene((*room_walls((-4.0, -3.0), (4.0, 3.0)), *boxes), textures=board)
    first, second, third = room.textures
    orders = (first, second, third), (third, first, second), (second, third // 2, first)
    rooms = [replace(room, textures=order) for order in orders]
    pose = Pose.planar(0.0, 0.0, 0.1)
    with open_renderer("gl") as together:
        for room in rooms:
            together.load(room, CameraConfig())
            found = together.render(pose).rgb
            with open_renderer("gl") as alone:
                alone.load(room, CameraConfig())
                assert np.array_equal(found, alone.render(pose).rgb)
