"""Fallback renderer with PyBullet's TinyRenderer, which needs no driver and has about a twentieth of OpenGL's speed.

Each part has its texture, mean colour and mean light, because TinyRenderer supports neither colours nor light
per vertex. Parts whose texture cuts holes are divided into small triangles, of which those in holes are omitted.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Hashable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.errors import UsageError
from schemas.frame import Frame
from schemas.rig import Camera
from schemas.scene import DRAWN, CompiledScene, Layer
from schemas.support.closing import Closing
from schemas.support.stage_timer import StageTimer, no_stage_timer
from workers.geometry.camera import OpticalPose, Perspective, optical_pose, view_matrix
from workers.geometry.faces import FacePlan
from workers.geometry.pose import Pose
from workers.physics.bullet import BulletClient, bullet_version
from workers.physics.mesh_lists import MESH_TRIANGLES
from workers.render import CameraImage, DepthAndIds, RenderedAtlas
from workers.render.compose import compose_image
from workers.render.prepared_scenes import KEPT_SCENES, PreparedSceneCache
from workers.render.sky import SkyPainter

_TEXTURE_PX = 128
"""Size to which textures are reduced, pixels: TinyRenderer samples single texels, which flicker at full resolution."""


class TinyRenderer(Closing):
    """Software `Renderer` that runs wherever PyBullet runs."""

    def __init__(
        self, size: int = FRAME_SIZE_PX, timer: StageTimer = no_stage_timer, kept_scenes: int = KEPT_SCENES
    ) -> None:
        """Creates the renderer.

        Args:
            size: width and height of the frames, pixels.
            timer: called at the end of the stages `render` and `read-back` of every frame.
            kept_scenes: number of scenes that stay prepared.
        """
        self.description = f"PyBullet TinyRenderer {bullet_version()}"
        self._camera = CameraConfig()
        self._size = size
        self._timer = timer
        self._shelf = PreparedSceneCache(TinyScene, kept_scenes)
        self._scene: TinyScene | None = None
        self._sky = SkyPainter(None)

    def close(self) -> None:
        """Frees the physics clients of the scenes; further calls have no effect."""
        self._shelf.clear()
        self._scene = None

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Selects the scene and the camera; recently used scenes stay prepared."""
        # the cache keeps the lambda and thus the scene, so no other scene gets its id
        self.load_by_key(id(scene), lambda: scene, camera)

    def load_by_key(self, key: Hashable, read: Callable[[], CompiledScene], camera: CameraConfig) -> None:
        self._camera = camera
        self._scene = self._shelf.take(key, read)
        self._sky = SkyPainter(self._scene.sky)

    def make_room(self) -> None:
        """Frees prepared scenes in advance, so the next scene fits; see `Renderer`."""
        self._shelf.make_room()
        if not self._shelf.keys:  # without prepared scenes, the selected scene was freed, too
            self._scene = None

    def render(self, pose: Pose, size: int | None = None) -> Frame:
        """Returns the camera image for a pose of base_link.

        Args:
            pose: pose of base_link in the world.
            size: width and height of the frame, pixels; `None` is the default size of the renderer.

        Raises:
            UsageError: no scene was loaded.
        """
        return self._render(Perspective.of(self._camera, size or self._size), optical_pose(pose, self._camera))

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        """Returns depth and ids; takes as long as `render`."""
        frame = self.render(pose)
        return DepthAndIds(frame.depth, frame.ids)

    def render_camera(self, camera: Camera, pose: Pose) -> CameraImage:
        """Returns the image of a camera of a rig for a pose of base_link; raises the errors of `render_faces`."""
        return compose_image(self, camera, pose)

    def render_faces(self, plan: FacePlan, optical: OpticalPose, normals: bool = False) -> RenderedAtlas:
        """Returns the atlas of the faces of a camera.

        Raises:
            UsageError: no scene was loaded, or normals are requested.
        """
        if normals:
            raise UsageError("TinyRenderer has no normals: use the renderer gl, or remove `normals` from outputs")
        rgb = np.zeros((plan.height, plan.width, 3 if plan.sampling is None else 4), np.uint8)
        atlas = RenderedAtlas(rgb, np.zeros(rgb.shape[:2], np.float32), np.zeros(rgb.shape[:2], np.uint16))
        for face in plan.faces:
            part = np.s_[face.top : face.top + face.view.height, : face.view.width]
            frame = self._render(face.view, face.optical(optical))
            rgb[part][..., :3], atlas.depth[part], atlas.ids[part] = frame.rgb, frame.depth, frame.ids
        return atlas

    def _render(self, view: Perspective, optical: OpticalPose) -> Frame:
        if self._scene is None:
            raise UsageError("no scene is loaded: call load(scene, camera) before render(pose)")
        camera = view_matrix(optical), _at_pixel_centres(view)
        rgba, nearness, bodies = self._scene.client.camera_image(view.width, view.height, *camera)
        self._timer("render")
        near, far = view.near_m, view.far_m
        instance_of_body = self._scene.instance_of_body
        depth = far * near / (far - (far - near) * nearness.astype(np.float64))
        hit = (bodies >= 0) & (depth >= near) & (depth <= far)
        frame = Frame(
            rgb=rgba[:, :, :3] * hit[:, :, None].astype(np.uint8),
            depth=np.where(hit, depth, 0.0).astype(np.float32),
            ids=np.where(hit, instance_of_body[bodies], 0).astype(np.uint16),
        )
        self._sky.paint(frame.rgb, frame.depth, optical, view)
        self._timer("read-back")
        return frame


def _at_pixel_centres(view: Perspective) -> NDArray[np.float64]:
    """Returns the projection shifted by half a pixel: TinyRenderer samples the corner of a pixel, not its centre."""
    shifted = view.matrix()
    shifted[:2, 2] += 1.0 / view.width, 1.0 / view.height
    return shifted


class TinyScene:
    """Scene as visual bodies in a separate physics client."""

    def __init__(self, scene: CompiledScene) -> None:
        self.sky = scene.info.sky
        self.client = BulletClient()
        instances: dict[int, int] = {}
        with tempfile.TemporaryDirectory() as folder:
            textures = [self.client.load_texture(path) for path in _write_textures(scene.textures, Path(folder))]
        light = _light_at_vertices(scene)
        for part, run in _runs(scene):
            rgb = scene.colours[run].mean(axis=0) / 255 * light[run].mean(axis=0)
            for positions, uvs in _shapes(scene, part, run):
                body = self.client.add_visual(positions, uvs, (rgb[0], rgb[1], rgb[2]))
                instances[body] = int(scene.part_instance[part])
                if scene.part_texture[part] >= 0:
                    self.client.set_texture(body, textures[scene.part_texture[part]])
        self.instance_of_body = np.zeros(max(instances, default=0) + 1, np.uint16)
        for body, instance in instances.items():
            self.instance_of_body[body] = instance

    def close(self) -> None:
        self.client.close()


def _shapes(scene: CompiledScene, part: int, run: slice) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yields vertices and texture coordinates of the shapes of a run; more than one if its texture cuts holes."""
    positions, uvs = scene.positions[run], scene.uvs[run]
    if not scene.part_is_cut[part]:
        yield positions, uvs
        return
    positions, uvs = cut_holes(positions, uvs, scene.masks[int(scene.part_texture[part])])
    for first in range(0, len(positions), 3 * MESH_TRIANGLES):
        yield positions[first : first + 3 * MESH_TRIANGLES], uvs[first : first + 3 * MESH_TRIANGLES]


_FINEST, _COARSEST = 1 / 64, 1 / 8
"""Sides of the smallest and of the largest small triangles, as shares of a mask."""
_MOST_CUT = 400_000
"""Number of small triangles of a part from which on they are not divided again."""
_SPOTS = np.array([(i, j, 6 - i - j) for i in range(7) for j in range(7 - i)]) / 6
"""(28, 3) places in a triangle at which its mask is tested."""


def cut_holes(
    positions: NDArray[np.float32], uvs: NDArray[np.float32], mask: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Returns the vertices and texture coordinates of the small triangles of a part that are not in holes of its mask.

    Args:
        positions: (V, 3) corners of triangles, metres.
        uvs: (V, 2) texture coordinates.
        mask: (H, W) mask, top row first.
    """
    corners = np.concatenate((positions, uvs), axis=1).astype(np.float64).reshape(-1, 3, 5)
    kept = list[NDArray[np.float64]]()
    while len(corners):
        sides = np.linalg.norm(corners[..., 3:] - np.roll(corners[..., 3:], 1, axis=1), axis=2).max(axis=1)
        share = _drawn(corners[..., 3:], mask).mean(axis=1)
        is_mixed = (sides > _COARSEST) | ((share > 0) & (share < 1) & (sides > _FINEST))
        if sum(map(len, kept)) + 4 * np.count_nonzero(is_mixed) > _MOST_CUT:
            is_mixed[:] = False
        kept.append(corners[~is_mixed & (share >= 0.5)])
        corners = _quartered(corners[is_mixed])
    small = np.concatenate(kept).reshape(-1, 5).astype(np.float32)
    return small[:, :3], small[:, 3:]


def _drawn(uvs: NDArray[np.float64], mask: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Returns whether each triangle (T, 3, 2) is drawn at each of the places `_SPOTS`."""
    rows, columns = mask.shape
    u, v = np.moveaxis(np.einsum("sk,tkc->tsc", _SPOTS, uvs) % 1.0, 2, 0)
    row, column = np.minimum((1 - v) * rows, rows - 1), np.minimum(u * columns, columns - 1)
    return np.asarray(mask[row.astype(np.int64), column.astype(np.int64)] >= DRAWN)


def _quartered(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the four triangles of each triangle (T, 3, K) between its corners and the middles of its sides."""
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [np.stack(triangle, axis=1) for triangle in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate(parts)


def _runs(scene: CompiledScene) -> Iterator[tuple[int, slice]]:
    """Yields (part, range of vertices); a part that is too large for one shape has several ranges."""
    for part, (first, count) in enumerate(zip(scene.part_first.tolist(), scene.part_count.tolist(), strict=True)):
        for start in range(first, first + count, 3 * MESH_TRIANGLES):
            yield part, slice(start, min(start + 3 * MESH_TRIANGLES, first + count))


def _light_at_vertices(scene: CompiledScene) -> NDArray[np.float64]:
    """Returns (V, 3) baked light, 0..1, at the texel nearest to each vertex."""
    if not scene.light_map.size:
        return np.ones((len(scene.positions), 3))
    rows, columns = scene.light_map.shape[:2]
    texels = (scene.light_uvs * (columns, rows)).astype(np.int64).clip(0, (columns - 1, rows - 1))
    return np.asarray(scene.light_map[texels[:, 1], texels[:, 0]] / 255.0)


def _write_textures(textures: Sequence[Layer], folder: Path) -> Iterator[Path]:
    for layer, pixels in enumerate(textures):
        path = folder / f"{layer}.png"
        Image.fromarray(pixels).resize((_TEXTURE_PX, _TEXTURE_PX), Image.Resampling.BOX).save(path)
        yield path
