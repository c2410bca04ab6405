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
from schemas.lap import Lap, no_lap
from schemas.scene import CompiledScene
from workers.camera import OpticalPose, optical_pose, projection_matrix, view_matrix
from workers.pose import Pose
from workers.render import Frame, Relief
from workers.render.cull import PartBounds, visible_parts
from workers.render.occlude import Screens
from workers.render.shaders import BARE, PLAIN, TEXTURED, VERTEX, ShaderPair
from workers.render.shelf import SceneShelf

__all__ = ["GlRenderer"]

_KEPT_SCENES = 4
_TEXTURE_UNIT, _LIGHT_UNIT = 0, 1
_EGL: dict[str, Any] = {"backend": "egl", "libegl": "libEGL.so.1", "libgl": "libEGL.so.1"}
"""libEGL hands out every function of OpenGL by itself; asking for no libGL spares the user a package."""
_DRAW = np.dtype([("count", "u4"), ("instances", "u4"), ("first", "u4"), ("base", "u4"), ("unused", "u4")])
"""OpenGL's DrawArraysIndirectCommand; moderngl strides over five words, whether indexed or not."""
_ALL_TARGETS: Any = ((True,) * 4,) * 3
_DEPTH_ONLY: Any = ((False,) * 4, (True,) * 4, (False,) * 4)
"""Masks of colour, depth and ids; moderngl's types know only that of one target."""
_TOP_ROW_FIRST = np.diag((1.0, -1.0, 1.0, 1.0))
"""Mirrors the image, so that its top row comes first in memory, where OpenGL has the bottom row."""


class GlRenderer:
    """A `Renderer` on an OpenGL 4.3 context of its own; every call makes that context current."""

    def __init__(self, size: int = FRAME_SIZE_PX, lap: Lap = no_lap) -> None:
        """Opens the context and its targets.

        Args:
            size: width and height of the frames, pixels.
            lap: told the end of the stages `render` and `read-back` of every frame.

        Raises:
            WorldError: this machine has no usable EGL driver.
        """
        self._camera = CameraConfig()
        self._size = size
        self._lap = lap
        self._context = _open_context()
        self._is_open = True
        self.description = _describe(self._context)
        self._shelf = SceneShelf(self._prepare, _KEPT_SCENES)
        self._scene: _GpuScene | None = None
        with self._context:
            self._plain, self._textured, self._bare = (
                _Program(self._context, pair) for pair in (PLAIN, TEXTURED, BARE)
            )
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
        scene = self._loaded()
        clip, parts = self._look(scene, pose)
        with self._context:
            self._begin()
            self._plain.set_view(clip)
            self._textured.set_view(clip)
            scene.draw(parts)
            self._context.finish()  # reading would wait just as long; so the wait is told apart from the copy
            self._lap("render")
            rgb = np.empty((self._size, self._size, 3), np.uint8)
            self._rgb.read_into(rgb)
            relief = self._read_relief(rgb)
        self._lap("read-back")
        return Frame(rgb, relief.depth, relief.ids)

    def render_relief(self, pose: Pose) -> Relief:
        """Returns depth and ids without drawing colour; the same parts in the same order give the same bits.

        Raises:
            UsageError: no scene was loaded.
        """
        scene = self._loaded()
        clip, parts = self._look(scene, pose)
        with self._context:
            self._begin()
            self._bare.set_view(clip)
            scene.draw_bare(parts)
            self._context.finish()
            self._lap("render")
            relief = self._read_relief()
        self._lap("read-back")
        return relief

    def _loaded(self) -> _GpuScene:
        if self._scene is None:
            raise UsageError("nothing to render: call load(scene, camera) before render(pose)")
        return self._scene

    def _look(self, scene: _GpuScene, pose: Pose) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Returns the clip matrix of a pose and the parts to be drawn from it."""
        optical = optical_pose(pose, self._camera)
        clip = _TOP_ROW_FIRST @ projection_matrix(self._camera) @ view_matrix(optical)
        return clip, scene.parts_to_draw(clip, optical, self._camera)

    def _begin(self) -> None:
        """Takes the targets and clears what tells where nothing is: colour and ids are blanked there after reading."""
        self._target.use()
        self._target.color_mask = _DEPTH_ONLY
        self._target.clear()
        self._target.color_mask = _ALL_TARGETS

    def _read_relief(self, *beside: NDArray[np.uint8]) -> Relief:
        """Reads depth and ids; blanks the ids, and what was read beside them, where nothing is."""
        shape = (self._size, self._size)
        depth, ids = np.empty(shape, np.float32), np.empty(shape, np.uint16)
        self._depth.read_into(depth)
        np.minimum(depth, self._camera.far_m, out=depth)  # the far plane cuts to half a millimetre
        self._ids.read_into(ids)
        if not depth.all():
            void = np.flatnonzero(depth == 0)
            images: tuple[NDArray[Any], ...] = (ids, *beside)
            for image in images:
                image.reshape(self._size * self._size, -1)[void] = 0
        return Relief(depth, ids)

    def _prepare(self, scene: CompiledScene) -> _GpuScene:
        return _GpuScene(self._context, self._plain, self._textured, self._bare, scene)


class _Program:
    """A compiled pair of shaders."""

    def __init__(self, context: moderngl.Context, pair: ShaderPair) -> None:
        self._context = context
        self._pair = pair
        self._program: Any = context.program(vertex_shader=pair.vertex, fragment_shader=pair.fragment)
        if "light" in self._program:
            self._program["light"] = _LIGHT_UNIT

    def set_view(self, clip: NDArray[np.float64]) -> None:
        self._program["clip_from_world"].write(clip.T.astype(np.float32).tobytes())

    def reading(self, vertices: moderngl.Buffer) -> moderngl.VertexArray:
        return self._context.vertex_array(self._program, [(vertices, self._pair.layout, *self._pair.fields)])


class _GpuScene:
    """A scene on the device: its vertices, textures and light map; and what tells which of its parts are in view."""

    def __init__(
        self,
        context: moderngl.Context,
        plain: _Program,
        textured: _Program,
        bare: _Program,
        scene: CompiledScene,
    ) -> None:
        self._is_textured = scene.part_texture >= 0
        self._bounds, self._screens = PartBounds.of(scene), Screens.of(scene)
        self._draws = np.zeros(len(scene.part_first), _DRAW)
        self._draws["count"], self._draws["first"] = scene.part_count, scene.part_first
        self._draws["instances"] = 1
        self._commands = context.buffer(reserve=max(1, self._draws.nbytes), dynamic=True)
        self._vertices = context.buffer(_interleave(scene).tobytes() or bytes(VERTEX.itemsize))
        self._plain, self._textured = plain.reading(self._vertices), textured.reading(self._vertices)
        self._bare = bare.reading(self._vertices)
        self._textures = _upload_textures(context, scene.textures)
        self._light = _upload_light(context, scene.light_map)

    def parts_to_draw(self, clip: NDArray[np.float64], optical: OpticalPose, camera: CameraConfig) -> NDArray[np.intp]:
        """Returns the parts that reach into the view and do not stand behind a wall, nearest first."""
        parts = visible_parts(self._bounds, clip, optical.eye)
        return parts[~self._screens.hidden(self._bounds, parts, optical, camera)]

    def draw(self, parts: NDArray[np.intp]) -> None:
        """Draws parts in the order given, the plain ones first: what they hide needs no texture looked up."""
        order, plain = self._order(parts)
        self._light.use(_LIGHT_UNIT)
        if plain:
            self._plain.render_indirect(self._commands, count=plain)
        if plain < len(order):
            self._textures.use(_TEXTURE_UNIT)
            self._textured.render_indirect(self._commands, count=len(order) - plain, first=plain)

    def draw_bare(self, parts: NDArray[np.intp]) -> None:
        """Draws depth and ids of parts, in the order of `draw`."""
        order, _ = self._order(parts)
        if len(order):
            self._bare.render_indirect(self._commands, count=len(order))

    def _order(self, parts: NDArray[np.intp]) -> tuple[NDArray[np.intp], int]:
        """Lays down what is to be drawn, the plain parts first; returns it, and how many are plain."""
        is_textured = self._is_textured[parts]
        order = np.concatenate((parts[~is_textured], parts[is_textured]))
        if len(order):
            self._commands.write(self._draws[order].tobytes())
        return order, len(parts) - int(is_textured.sum())

    def close(self) -> None:
        """Frees the device memory."""
        for held in (
            self._plain,
            self._textured,
            self._bare,
            self._vertices,
            self._commands,
            self._textures,
            self._light,
        ):
            held.release()


def _interleave(scene: CompiledScene) -> NDArray[np.void]:
    """Returns the vertices as the shader reads them; what belongs to a part is repeated for each of its vertices."""
    vertices = np.zeros(len(scene.positions), VERTEX)
    vertices["position"], vertices["uv"] = scene.positions, scene.uvs
    vertices["colour"][:, :3] = scene.colours
    if len(scene.light_uvs):
        vertices["light_uv"] = scene.light_uvs
    for first, count, instance, layer in zip(
        scene.part_first, scene.part_count, scene.part_instance, scene.part_texture, strict=True
    ):
        run = slice(first, first + count)
        vertices["instance"][run], vertices["layer"][run] = instance, layer
    return vertices


def _upload_textures(context: moderngl.Context, textures: NDArray[np.uint8]) -> moderngl.TextureArray:
    """Uploads the layers upside down, because v = 0 is the bottom row, and makes their mipmaps.

    The nearest mipmap alone is sampled: mixing two of them looks the same here and costs as much as the light map.
    """
    layers = textures[:, ::-1] if len(textures) else np.full((1, 1, 1, 3), 255, np.uint8)
    count, height, width, _ = layers.shape
    array = context.texture_array((width, height, count), 3, np.ascontiguousarray(layers))
    array.build_mipmaps()
    array.filter = (moderngl.LINEAR_MIPMAP_NEAREST, moderngl.LINEAR)
    return array


def _upload_light(context: moderngl.Context, light_map: NDArray[np.uint8]) -> moderngl.Texture:
    """Uploads the light map, with a fourth channel that llvmpipe is faster with; without one, all is fully lit."""
    rows, columns = light_map.shape[:2] if light_map.size else (1, 1)
    texels = np.full((rows, columns, 4), 255, np.uint8)
    if light_map.size:
        texels[:, :, :3] = light_map
    texture = context.texture((columns, rows), 4, texels)
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    texture.repeat_x = texture.repeat_y = False
    return texture


def _open_context() -> moderngl.Context:
    try:
        return moderngl.create_context(require=430, standalone=True, **_EGL)
    except Exception as error:  # glcontext raises nothing more specific
        raise WorldError(f"no OpenGL 4.3 through EGL on this machine: {error}") from error


def _describe(context: moderngl.Context) -> str:
    return f"{context.info['GL_RENDERER']}; OpenGL {context.info['GL_VERSION']}"
