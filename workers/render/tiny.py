"""Fallback renderer with PyBullet's TinyRenderer, which needs no driver and has about a twentieth of OpenGL's speed.

Each part has its mean colour and light, because TinyRenderer supports neither per vertex. Does not simulate.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Hashable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.config import CameraConfig
from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.errors import UsageError
from schemas.scene import CompiledScene
from schemas.support.closing import Closing
from schemas.support.stage_timer import StageTimer, no_stage_timer
from workers.geometry.camera import optical_pose, projection_matrix, view_matrix
from workers.geometry.pose import Pose
from workers.physics.bullet import BulletClient, CameraImage, bullet_version
from workers.physics.mesh_lists import MESH_TRIANGLES
from workers.render import DepthAndIds, RenderedFrame
from workers.render.shelf import KEPT_SCENES, SceneShelf
from workers.render.sky import SkyPainter

_TEXTURE_PX = 128
"""Size to which textures are reduced, pixels: TinyRenderer samples single texels, which flicker at full resolution."""


class TinyRenderer(Closing):
    """Software `Renderer` that runs wherever PyBullet runs."""

    def __init__(
        self, size: int = FRAME_SIZE_PX, lap: StageTimer = no_stage_timer, kept_scenes: int = KEPT_SCENES
    ) -> None:
        """Creates the renderer.

        Args:
            size: width and height of the frames, pixels.
            lap: called at the end of the stages `render` and `read-back` of every frame.
            kept_scenes: number of scenes that stay prepared.
        """
        self.description = f"PyBullet TinyRenderer {bullet_version()}"
        self._camera = CameraConfig()
        self._size = size
        self._lap = lap
        self._shelf = SceneShelf(TinyScene, kept_scenes)
        self._scene: TinyScene | None = None
        self._sky = SkyPainter(None, self._camera)

    def close(self) -> None:
        """Frees the physics clients of the scenes; further calls have no effect."""
        self._shelf.clear()
        self._scene = None

    def load(self, scene: CompiledScene, camera: CameraConfig) -> None:
        """Selects the scene and the camera; recently used scenes stay prepared."""
        self.load_by_key(id(scene), lambda: scene, camera)  # the function holds the scene, so that its id stays unique

    def load_by_key(self, key: Hashable, read: Callable[[], CompiledScene], camera: CameraConfig) -> None:
        """Selects a scene by a key and the camera; see `Renderer`."""
        self._camera = camera
        self._scene = self._shelf.take(key, read)
        self._sky = SkyPainter(self._scene.sky, camera)

    def render(self, pose: Pose, size: int | None = None) -> RenderedFrame:
        """Returns the camera image for a pose of base_link.

        Args:
            pose: pose of base_link in the world.
            size: width and height of the frame, pixels; `None` is the default size of the renderer.

        Raises:
            UsageError: no scene was loaded.
        """
        if self._scene is None:
            raise UsageError("no scene is loaded: call load(scene, camera) before render(pose)")
        optical = optical_pose(pose, self._camera)
        size = size or self._size
        projection = _at_pixel_centres(projection_matrix(self._camera), size)
        image = self._scene.client.camera_image(size, view_matrix(optical), projection)
        self._lap("render")
        frame = self._frame(image, self._scene.instance_of_body)
        self._sky.paint(frame.rgb, frame.depth, optical)
        self._lap("read-back")
        return frame

    def render_depth_and_ids(self, pose: Pose) -> DepthAndIds:
        """Returns depth and ids; takes as long as `render`."""
        frame = self.render(pose)
        return DepthAndIds(frame.depth, frame.ids)

    def _frame(self, image: CameraImage, instance_of_body: NDArray[np.uint16]) -> RenderedFrame:
        near, far = self._camera.near_m, self._camera.far_m
        depth = far * near / (far - (far - near) * image.depth.astype(np.float64))
        hit = (image.bodies >= 0) & (depth >= near) & (depth <= far)
        return RenderedFrame(
            rgb=image.rgba[:, :, :3] * hit[:, :, None].astype(np.uint8),
            depth=np.where(hit, depth, 0.0).astype(np.float32),
            ids=np.where(hit, instance_of_body[image.bodies], 0).astype(np.uint16),
        )


def _at_pixel_centres(projection: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Returns the projection shifted by half a pixel: TinyRenderer samples the corner of a pixel, not its centre."""
    shifted = projection.copy()
    shifted[:2, 2] += 1.0 / size
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
            body = self.client.add_visual(scene.positions[run], scene.uvs[run], (rgb[0], rgb[1], rgb[2]))
            instances[body] = int(scene.part_instance[part])
            if scene.part_texture[part] >= 0:
                self.client.set_texture(body, textures[scene.part_texture[part]])
        self.instance_of_body = np.zeros(max(instances, default=0) + 1, np.uint16)
        for body, instance in instances.items():
            self.instance_of_body[body] = instance

    def close(self) -> None:
        """Frees the client."""
        self.client.close()


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


def _write_textures(textures: NDArray[np.uint8], folder: Path) -> Iterator[Path]:
    for layer, pixels in enumerate(textures):
        path = folder / f"{layer}.png"
        Image.fromarray(pixels).resize((_TEXTURE_PX, _TEXTURE_PX), Image.Resampling.BOX).save(path)
        yield path
