"""Fallback renderer with PyBullet's TinyRenderer, which needs no driver and has about a twentieth of OpenGL's speed.

Each part has its texture, mean colour and mean light, because TinyRenderer supports neither colours nor light
per vertex.
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
from schemas.scene import CompiledScene, Layer
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
            body = self.client.add_visual(scene.positions[run], scene.uvs[run], (rgb[0], rgb[1], rgb[2]))
            instances[body] = int(scene.part_instance[part])
            if scene.part_texture[part] >= 0:
                self.client.set_texture(body, textures[scene.part_texture[part]])
        self.instance_of_body = np.zeros(max(instances, default=0) + 1, np.uint16)
        for body, instance in instances.items():
            self.instance_of_body[body] = instance

    def close(self) -> None:
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


def _write_textures(textures: Sequence[Layer], folder: Path) -> Iterator[Path]:
    for layer, pixels in enumerate(textures):
        path = folder / f"{layer}.png"
        Image.fromarray(pixels).resize((_TEXTURE_PX, _TEXTURE_PX), Image.Resampling.BOX).save(path)
        yield path
