"""Scenes on the graphics device and the shader programs that draw them, for the OpenGL renderer.

Selects the visible parts of a scene and draws them. Does not manage targets or read back images.
"""

from __future__ import annotations

from itertools import groupby
from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.scene import CompiledScene
from workers.geometry.camera import OpticalPose, Perspective
from workers.render import Window
from workers.render.gl_textures import TextureStore
from workers.render.shaders import BARE, NORMALS, PLAIN, TEXTURED, VERTEX, ShaderPair
from workers.render.visible_parts import Edges, Occluders, PartBounds, may_reach, visible_parts, window_of_corners

_TEXTURE_UNIT, _LIGHT_UNIT, _MASK_UNIT = 0, 1, 2
_DRAW = np.dtype([("count", "u4"), ("instances", "u4"), ("first", "u4"), ("base_vertex", "i4"), ("base", "u4")])
"""OpenGL's DrawElementsIndirectCommand."""
_HASH_STEP, _HASH_SHIFT = np.uint64(0x9E3779B97F4A7C15), np.uint64(29)
_BANDS = 3
"""Number of distance bands. In each band, parts without texture are drawn first, because pixels that they hide need no
texture lookup. With fewer bands, distant parts are drawn and then covered; with more, the programs change too often."""


class _Program:
    """Compiled pair of shaders."""

    def __init__(self, context: moderngl.Context, pair: ShaderPair) -> None:
        self._context = context
        self._pair = pair
        self._program: Any = context.program(vertex_shader=pair.vertex, fragment_shader=pair.fragment)
        if "light" in self._program:
            self._program["light"] = _LIGHT_UNIT
        if "masks" in self._program:
            self._program["masks"] = _MASK_UNIT

    def set_clip_matrix(self, clip_from_world: bytes) -> None:
        self._program["clip_from_world"].write(clip_from_world)

    def set_eye(self, eye: NDArray[np.float64]) -> None:
        self._program["eye"].value = tuple(eye.tolist())

    def vertex_array(self, mesh: _Mesh) -> moderngl.VertexArray:
        content = [(mesh.vertices, self._pair.layout, *self._pair.fields)]
        return self._context.vertex_array(self._program, content, mesh.corners, index_element_size=4)


class _Mesh(NamedTuple):
    """Indexed mesh of a scene on the device, without duplicate vertices."""

    vertices: moderngl.Buffer
    corners: moderngl.Buffer

    @classmethod
    def of(cls, context: moderngl.Context, scene: CompiledScene) -> _Mesh:
        every = _interleave(scene)
        firsts, inverse = _unique_rows(every)
        order = np.argsort(firsts)  # in the order of the parts, so the vertices of a part are contiguous
        rank = np.empty(len(order), np.uint32)
        rank[order] = np.arange(len(order))
        vertices, corners = every[firsts[order]], rank[inverse]
        return cls(
            context.buffer(vertices.tobytes() or bytes(VERTEX.itemsize)), context.buffer(corners.tobytes() or bytes(4))
        )


class Programs:
    """Shader programs, each compiled when the first scene needs it."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._made: dict[ShaderPair, _Program] = {}

    def of(self, pair: ShaderPair) -> _Program:
        if pair not in self._made:
            self._made[pair] = _Program(self._context, pair)
        return self._made[pair]


class DrawOrder(NamedTuple):
    """Parts of an image in the order in which they are drawn."""

    parts: NDArray[np.intp]
    """Indices of the parts."""
    runs: list[int]
    """Numbers of plain, of textured and, in a scene with masks, of cut-out parts in each distance band, by turns."""


class GpuScene:
    """Vertices, textures and light map of a scene on the device, with the bounds for culling."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, textures: TextureStore, scene: CompiledScene
    ) -> None:
        """Uploads a scene.

        Args:
            context: OpenGL context, which must be current.
            programs: programs of the same context.
            textures: textures of the prepared scenes of the same context.
            scene: scene to upload.
        """
        self.sky = scene.info.sky
        """Background of the scene; `None` is black."""
        self._is_cut = scene.part_is_cut
        self._kind = (scene.part_texture >= 0).astype(np.int64) + self._is_cut
        self._bounds, self._occluders = PartBounds.of(scene), Occluders.of(scene)
        self._instances = scene.part_instance
        self._draws = np.zeros(len(scene.part_first), _DRAW)
        self._draws["count"], self._draws["first"] = scene.part_count, scene.part_first
        self._draws["instances"] = 1
        self._commands = context.buffer(reserve=max(1, self._draws.nbytes), dynamic=True)
        self._mesh = _Mesh.of(context, scene)
        pairs = [PLAIN, TEXTURED] if _has_flat_colours(scene) else [PLAIN.blended(), TEXTURED.blended()]
        pairs += [pairs[1].cut_out()] if scene.masks else []
        self._coloured = [programs.of(pair) for pair in pairs]
        self._by_kind = [program.vertex_array(self._mesh) for program in self._coloured]
        self._programs = programs
        self._solid_and_cut: dict[ShaderPair, list[tuple[_Program, moderngl.VertexArray]]] = {}
        self._masks = _upload_masks(context, scene) if scene.masks else None
        self._textures = textures.upload(scene.textures)
        self._light = _upload_light(context, scene.light_map)

    def order(self, clip: NDArray[np.float64], optical: OpticalPose, image: Perspective) -> DrawOrder:
        """Returns the parts that are in view and not behind a wall, nearest first in bands, plain before textured."""
        seen = visible_parts(self._bounds, clip, optical.eye)
        parts = seen[~self._occluders.hidden(self._bounds, seen, optical, image)]
        count = len(parts)
        run = np.arange(count) * _BANDS // max(count, 1) * len(self._by_kind) + self._kind[parts]
        return DrawOrder(parts[np.argsort(run, kind="stable")], np.bincount(run).tolist())

    def window_of(
        self, drawn: DrawOrder, instance_id: int, clip: NDArray[np.float64], camera: CameraConfig, size: int
    ) -> tuple[Window, float]:
        """Returns a window with all pixels of an instance, and the largest depth of its drawn parts in metres."""
        own_parts = drawn.parts[self._instances[drawn.parts] == instance_id]
        return window_of_corners(self._bounds.corners(own_parts), clip, camera.near_m, size)

    def parts_before(self, drawn: DrawOrder, optical: OpticalPose, edges: Edges, depth_m: float) -> NDArray[np.intp]:
        """Returns the drawn parts that may be visible between these edges up to a depth in metres, in drawing order."""
        # the order of the whole image is kept, because it decides which of two surfaces of equal depth is visible
        return drawn.parts[may_reach(self._bounds.facts[:, drawn.parts], optical, edges, depth_m)]

    def parts_within(self, optical: OpticalPose, edges: Edges, depth_m: float) -> NDArray[np.intp]:
        """Returns the parts that may have a point between these edges up to a depth in metres, in any order."""
        return np.flatnonzero(may_reach(self._bounds.facts, optical, edges, depth_m))

    def draw(self, drawn: DrawOrder, clip_from_world: bytes) -> None:
        """Draws colour, depth and ids of parts.

        Args:
            drawn: parts to draw.
            clip_from_world: (4, 4) float32 matrix in column order.
        """
        for program in self._coloured:
            program.set_clip_matrix(clip_from_world)
        self._light.use(_LIGHT_UNIT)
        self._textures.use(_TEXTURE_UNIT)
        if self._masks is not None:
            self._masks.use(_MASK_UNIT)
        self._write_commands(drawn.parts)
        first = 0
        for run, count in enumerate(drawn.runs):
            if count:
                self._by_kind[run % len(self._by_kind)].render_indirect(self._commands, count=count, first=first)
            first += count

    def draw_bare(self, parts: NDArray[np.intp], clip_from_world: bytes) -> None:
        """Draws depth and ids of parts in the given order, which decides between surfaces of equal depth."""
        self._draw_in_order(parts, self._pairs_of(BARE, clip_from_world))

    def draw_normals(self, parts: NDArray[np.intp], clip_from_world: bytes, eye: NDArray[np.float64]) -> None:
        """Draws encoded normals instead of colour, depth and ids of parts, see `shaders.NORMALS`."""
        pairs = self._pairs_of(NORMALS, clip_from_world)
        for program, _ in pairs:
            program.set_eye(eye)
        self._draw_in_order(parts, pairs)

    def _pairs_of(self, pair: ShaderPair, clip_from_world: bytes) -> list[tuple[_Program, moderngl.VertexArray]]:
        """Returns the programs of solid and, in a scene with masks, of cut-out parts, with their vertex arrays."""
        if pair not in self._solid_and_cut:
            programs = [self._programs.of(each) for each in ((pair, pair.cut_out()) if self._masks else (pair,))]
            self._solid_and_cut[pair] = [(program, program.vertex_array(self._mesh)) for program in programs]
        for program, _ in self._solid_and_cut[pair]:
            program.set_clip_matrix(clip_from_world)
        return self._solid_and_cut[pair]

    def _draw_in_order(self, parts: NDArray[np.intp], pairs: list[tuple[_Program, moderngl.VertexArray]]) -> None:
        if not len(parts):
            return
        self._write_commands(parts)
        if self._masks is None:
            pairs[0][1].render_indirect(self._commands, count=len(parts))
            return
        self._masks.use(_MASK_UNIT)
        first = 0
        for is_cut, run in groupby(self._is_cut[parts].tolist()):
            count = len(list(run))
            pairs[is_cut][1].render_indirect(self._commands, count=count, first=first)
            first += count

    def _write_commands(self, parts: NDArray[np.intp]) -> None:
        self._commands.write(self._draws[parts].tobytes())

    def close(self) -> None:
        arrays = [array for pairs in self._solid_and_cut.values() for _, array in pairs]
        masks = [] if self._masks is None else [self._masks]
        held: tuple[Any, ...] = (*self._by_kind, *arrays, *self._mesh, self._commands, self._textures, self._light)
        for resource in (*held, *masks):
            resource.release()


def _unique_rows(vertices: NDArray[np.void]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Returns the first index of each distinct vertex, and for each vertex its index among the distinct vertices.

    Sorts hashes, which takes a fifth of the time of sorting the vertices; vertices with equal hashes are compared.
    """
    words = vertices.view(np.uint32).reshape(len(vertices), -1)
    hashes = np.zeros(len(words), np.uint64)
    for column in words.T:
        hashes = (hashes ^ column) * _HASH_STEP
        hashes ^= hashes >> _HASH_SHIFT
    _, firsts, unique_rows = np.unique(hashes, return_index=True, return_inverse=True)
    if np.array_equal(words[firsts[unique_rows]], words):
        return firsts, unique_rows
    _, firsts, unique_rows = np.unique(vertices.view(f"V{VERTEX.itemsize}"), return_index=True, return_inverse=True)
    return firsts, unique_rows


def _has_flat_colours(scene: CompiledScene) -> bool:
    corners = scene.colours.reshape(-1, 3, 3)
    return bool((corners == corners[:, :1]).all())


def _interleave(scene: CompiledScene) -> NDArray[np.void]:
    """Returns the vertices in the layout of the shader; properties of a part are repeated for each of its vertices."""
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


def _upload_masks(context: moderngl.Context, scene: CompiledScene) -> moderngl.TextureArray:
    """Uploads the masks at the places of their layers; the other layers of the array are not used."""
    height, width = next(iter(scene.masks.values())).shape
    array = context.texture_array((width, height, max(scene.masks) + 1), 1)
    for layer, mask in scene.masks.items():
        array.write(np.ascontiguousarray(mask[::-1]), (0, 0, layer, width, height, 1))
    array.filter = (moderngl.LINEAR, moderngl.LINEAR)
    return array


def _upload_light(context: moderngl.Context, light_map: NDArray[np.uint8]) -> moderngl.Texture:
    """Uploads the light map with a fourth channel, which llvmpipe reads faster; an empty map gives full brightness."""
    rows, columns = light_map.shape[:2] if light_map.size else (1, 1)
    texels = np.full((rows, columns, 4), 255, np.uint8)
    if light_map.size:
        texels[:, :, :3] = light_map
    texture = context.texture((columns, rows), 4, texels)
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    texture.repeat_x = texture.repeat_y = False
    return texture
