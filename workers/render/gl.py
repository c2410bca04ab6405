"""The OpenGL renderer: colour, depth and ids in one pass, on EGL without a screen; the only user of moderngl.

It never touches physics, encodes images or reads the environment: `LP_NUM_THREADS=0`, wanted for llvmpipe, is set by
the process that opens it, before it is opened.
"""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import moderngl
import numpy as np
from numpy.typing import NDArray

from schemas.arrays import FRAME_SIZE_PX
from schemas.config import CameraConfig
from schemas.errors import UsageError, WorldError
from schemas.scene import CompiledScene
from workers.camera import optical_pose, projection_matrix, view_matrix
from workers.pose import Pose
from workers.render import Frame
from workers.render.cull import PartBounds, visible_parts
from workers.render.shelf import SceneShelf

__all__ = ["GlRenderer"]

_KEPT_SCENES = 4
_EGL: dict[str, Any] = {"backend": "egl", "libegl": "libEGL.so.1", "libgl": "libEGL.so.1"}
"""libEGL hands out every function of OpenGL by itself; asking for no libGL spares the user a package."""
_VERTEX_SHADER = """
#version 330
in vec3 position; in vec2 uv; in vec4 colour; in int instance; in int texture_layer;
uniform mat4 clip_from_world;
out vec2 frag_uv; out vec3 frag_colour; flat out int frag_instance; flat out int frag_layer;
void main() {
    gl_Position = clip_from_world * vec4(position, 1.0);
    frag_uv = uv; frag_colour = colour.rgb; frag_instance = instance; frag_layer = texture_layer;
}
"""
_FRAGMENT_SHADER = """
#version 330
in vec2 frag_uv; in vec3 frag_colour; flat in int frag_instance; flat in int frag_layer;
uniform sampler2DArray layers;
layout(location = 0) out vec4 rgb; layout(location = 1) out float depth; layout(location = 2) out uint id;
void main() {
    vec3 texel = frag_layer < 0 ? vec3(1.0) : texture(layers, vec3(frag_uv, float(frag_layer))).rgb;
    rgb = vec4(frag_colour * texel, 1.0);
    depth = 1.0 / gl_FragCoord.w;
    id = uint(frag_instance);
}
"""
_VERTEX = np.dtype([("position", "3f4"), ("uv", "2f4"), ("colour", "4u1"), ("instance", "u2"), ("layer", "i2")])
_DRAW = np.dtype([("count", "u4"), ("instances", "u4"), ("first", "u4"), ("base", "u4"), ("unused", "u4")])
"""OpenGL's DrawArraysIndirectCommand; moderngl strides over five words, whether indexed or not."""
_TOP_ROW_FIRST = np.diag((1.0, -1.0, 1.0, 1.0))
"""Mirrors the image, so that its top row comes first in memory, where OpenGL has the bottom row."""


class GlRenderer:
    """A `Renderer` on an OpenGL 4.3 context of its own; every call makes that context current."""

    def __init__(self, size: int = FRAME_SIZE_PX) -> None:
        """Opens the context and its targets.

        Args:
            size: width and height of the frames, pixels.

        Raises:
            WorldError: this machine has no usable EGL driver.
        """
        self._camera = CameraConfig()
        self._size = size
        self._context = _open_context()
        self._is_open = True
        self.description = _describe(self._context)
        self._shelf = SceneShelf(self._prepare, _KEPT_SCENES)
        self._scene: _GpuScene | None = None
        with self._context:
            self._program: Any = self._context.program(vertex_shader=_VERTEX_SHADER, fragment_shader=_FRAGMENT_SHADER)
            shape = (size, size)
            self._rgb = self._context.texture(shape, 3)
            self._depth = self._context.texture(shape, 1, dtype="f4")
            self._ids = self._context.texture(shape, 1, dtype="u2")
            self._target = self._context.framebuffer(
                (self._rgb, self._depth, self._ids), self._context.depth_renderbuffer(shape)
            )
            self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            self._context.front_face = "cw"  # because `_TOP_ROW_FIRST` mirrors the image

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Frees the context and all in it; closing twice is harmless."""
        if self._is_open:
            self._is_open = False
            with self._context:
                self._shelf.clear()
            self._scene = None
            self._context.release()

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Makes `scene` the one that `camera` shows; the last few scenes stay on the device."""
        self._camera = camera
        with self._context:
            self._scene = self._shelf.take(scene)

    def render(self, pose: Pose) -> Frame:
        """Returns what the camera sees when base_link stands at `pose` in the world.

        Raises:
            UsageError: no scene was loaded.
        """
        if self._scene is None:
            raise UsageError("nothing to render: call load(scene, camera) before render(pose)")
        optical = optical_pose(pose, self._camera)
        clip = _TOP_ROW_FIRST @ projection_matrix(self._camera) @ view_matrix(optical)
        parts = visible_parts(self._scene.bounds, clip, optical.eye)
        with self._context:
            self._target.use()
            self._target.clear()  # zero bits in all three targets, the integer one included
            self._program["clip_from_world"].write(clip.T.astype(np.float32).tobytes())
            self._scene.draw(parts)
            return self._read()

    def _read(self) -> Frame:
        size = self._size
        rgb = np.empty((size, size, 3), np.uint8)
        depth, ids = np.empty((size, size), np.float32), np.empty((size, size), np.uint16)
        self._rgb.read_into(rgb)
        self._depth.read_into(depth)
        self._ids.read_into(ids)
        return Frame(rgb, depth, ids)

    def _prepare(self, scene: CompiledScene) -> _GpuScene:
        return _GpuScene(self._context, self._program, scene)


class _GpuScene:
    """A scene on the device: its vertices, its textures and the bounds of its parts."""

    def __init__(self, context: moderngl.Context, program: Any, scene: CompiledScene) -> None:
        self.bounds = PartBounds.of(scene)
        self._draws = np.zeros(len(scene.part_first), _DRAW)
        self._draws["count"], self._draws["first"] = scene.part_count, scene.part_first
        self._draws["instances"] = 1
        self._commands = context.buffer(reserve=max(1, self._draws.nbytes), dynamic=True)
        self._vertices = context.buffer(_interleave(scene).tobytes() or bytes(_VERTEX.itemsize))
        layout = (self._vertices, "3f4 2f4 4f1 1u2 1i2", "position", "uv", "colour", "instance", "texture_layer")
        self._array = context.vertex_array(program, [layout])
        self._textures = _upload_textures(context, scene.textures)

    def draw(self, parts: NDArray[np.intp]) -> None:
        """Draws parts in the order given."""
        if len(parts) == 0:
            return
        self._textures.use(0)
        self._commands.write(self._draws[parts].tobytes())
        self._array.render_indirect(self._commands, count=len(parts))

    def close(self) -> None:
        """Frees the device memory."""
        for held in (self._array, self._vertices, self._commands, self._textures):
            held.release()


def _interleave(scene: CompiledScene) -> NDArray[np.void]:
    """Returns the vertices as the shader reads them; what belongs to a part is repeated for each of its vertices."""
    vertices = np.zeros(len(scene.positions), _VERTEX)
    vertices["position"], vertices["uv"] = scene.positions, scene.uvs
    vertices["colour"][:, :3] = scene.colours
    for first, count, instance, layer in zip(
        scene.part_first, scene.part_count, scene.part_instance, scene.part_texture, strict=True
    ):
        run = slice(first, first + count)
        vertices["instance"][run], vertices["layer"][run] = instance, layer
    return vertices


def _upload_textures(context: moderngl.Context, textures: NDArray[np.uint8]) -> moderngl.TextureArray:
    """Uploads the layers upside down, because v = 0 is the bottom row, and makes their mipmaps."""
    layers = textures[:, ::-1] if len(textures) else np.full((1, 1, 1, 3), 255, np.uint8)
    count, height, width, _ = layers.shape
    array = context.texture_array((width, height, count), 3, np.ascontiguousarray(layers).tobytes())
    array.build_mipmaps()
    array.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    return array


def _open_context() -> moderngl.Context:
    try:
        return moderngl.create_context(require=430, standalone=True, **_EGL)
    except Exception as error:  # glcontext raises nothing more specific
        raise WorldError(f"no OpenGL 4.3 through EGL on this machine: {error}") from error


def _describe(context: moderngl.Context) -> str:
    return f"{context.info['GL_RENDERER']}; OpenGL {context.info['GL_VERSION']}"
