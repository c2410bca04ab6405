"""Renders frames while episodes are read, in rendering processes that all threads and all episodes of a process share.

Draws the appearance of an episode, and reduces larger frames against aliasing. A forked process starts other rendering
processes. Reads no bundles.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.dataset.packages import ScenePackage
from factory.support.settings import read_renderer
from schemas.appearance import Appearance, CameraChange, DrawnAppearance
from schemas.config import CameraConfig
from schemas.errors import WorldError
from schemas.frame import Frame
from schemas.job import Job
from schemas.rig import Camera
from schemas.scene import CompiledScene, encode_scene
from schemas.terms import RendererKind
from workers.appearance import apply_appearance, changed_camera, draw_appearance, recorded_camera
from workers.geometry.pose import Pose
from workers.render import CameraImage
from workers.render.choose import open_apart
from workers.render.process import ProcessRenderer

if TYPE_CHECKING:
    from workers.sensors.rays import SceneRays


Value = TypeVar("Value", bound=np.generic)


def shrink_frame(frame: Frame, block: int) -> Frame:
    """Returns a frame whose width and height are divided by `block`; the frame itself if `block` is 1."""
    if block == 1:
        return frame
    # not multisampling: it smooths edges but not textures, and a mean of ids or depths has no meaning
    depth, ids = middle_of_blocks(frame.depth, block), middle_of_blocks(frame.ids, block)
    return Frame(mean_of_blocks(frame.rgb, block), depth.copy(), ids.copy())


def mean_of_blocks(rgb: NDArray[np.uint8], block: int) -> NDArray[np.uint8]:
    """Returns the mean colour of each block of `block` x `block` pixels, (size, size, 3).

    Args:
        rgb: (block * size, block * size, 3) sRGB.
        block: width and height of a block, pixels.
    """
    return np.array(Image.fromarray(rgb).reduce(block))


def middle_of_blocks(image: NDArray[Value], block: int) -> NDArray[Value]:
    """Returns a view of the pixel in the middle of each block of `block` x `block` pixels, (size, size).

    If `block` is even, this is the pixel below and to the right of the middle.

    Args:
        image: (block * size, block * size), for example depth or ids, whose values must not be averaged.
        block: width and height of a block, pixels.
    """
    return image[block // 2 :: block, block // 2 :: block]


class AppearancePackage(NamedTuple):
    """Scene of an episode with its appearance, as a package for a renderer."""

    package: ScenePackage
    """Scene of the episode."""
    drawn: DrawnAppearance
    """Factors of the episode."""

    @property
    def sha256(self) -> str:
        """Key of the scene with its appearance; equal keys give equal images."""
        factors = self.drawn.model_dump_json(exclude={"name", "episode"}).encode()
        return hashlib.sha256(self.package.sha256.encode() + factors).hexdigest()

    def scene(self) -> CompiledScene:
        """Returns the scene with the appearance; raises the errors of `ScenePackage.appearance_scene`."""
        place = self.package.appearance_scene(self.drawn.light is not None)
        return apply_appearance(place.scene, place.light, self.drawn)

    def read(self) -> bytes:
        """Returns the scene as a package."""
        return encode_scene(self.scene(), level=1)

    def rays(self) -> SceneRays:
        """Returns the ray caster of the scene, which hits the clutter, too."""
        return _rays_of(self) if self.drawn.clutter else self.package.rays()


@functools.lru_cache(maxsize=2)
def _rays_of(varied: AppearancePackage) -> SceneRays:
    from workers.sensors.rays import SceneRays

    varied.package.rays()  # raises an error if the scene package or embreex is missing
    return SceneRays(varied.scene())


def drawn_for(ranges: Appearance, job: Job, package: ScenePackage, poses: NDArray[np.float64]) -> DrawnAppearance:
    """Returns the factors of an episode; raises the errors of `ScenePackage.appearance_scene`."""
    place = package.appearance_scene(ranges.light is not None)
    return draw_appearance(
        ranges,
        job.root_seed,
        episode=job.index,
        place=place,
        target=place.scene.info.target(job.target_id),
        poses=poses,
    )


KEPT_SCENES = 4
"""Number of scenes that a rendering process keeps prepared; the least recently used one is dropped."""
_REMEDY = (
    "the episode stores states, and its frames are rendered with OpenGL: on Debian `apt-get install libegl1 "
    "libgl1-mesa-dri`; MINIVLA_RENDERER=tiny uses PyBullet's TinyRenderer, whose colours differ"
)


class View(NamedTuple):
    """Everything that determines a rendered frame."""

    package: ScenePackage | AppearancePackage
    camera: CameraConfig
    pose: Pose
    size: int
    """Width and height, pixels."""
    change: CameraChange | None = None
    """Change of the camera, if its pose and lens are varied."""


class SharedRenderer:
    """Renderer for all threads of a process.

    The first frame opens a rendering process. A thread that finds all rendering processes busy opens another one, up
    to one for each core.

    Args:
        kind: type of the renderer.
    """

    def __init__(self, kind: RendererKind) -> None:
        self._kind = kind
        self._most = len(os.sched_getaffinity(0))
        self._returned = threading.Condition()
        self._free: list[ProcessRenderer] = []
        self._opened = 0
        self._last = threading.local()
        self._warns, self._warned = _is_first_loader_worker(), set[str]()

    def render_once(self, view: View, recorded_with: str) -> Frame:
        """Like `render`, but returns the last frame of this thread if its view is equal; do not modify the frame."""
        last: tuple[View, Frame] | None = getattr(self._last, "frame", None)
        if last is None or last[0] != view:
            last = self._last.frame = view, self.render(view, recorded_with)
        return last[1]

    def render(self, view: View, recorded_with: str) -> Frame:
        """Returns the frame of a view.

        Args:
            view: scene, camera, pose and size.
            recorded_with: description of the renderer that the episode was recorded with; a warning is logged when
                another one renders, because its frames may differ.

        Raises:
            WorldError: this machine cannot render; the message has the remedy.
            ArchiveCorrupt: the package of the scene was not found.
            UsageError: moderngl is not installed; the message names the extra.
        """
        package = view.package
        with self._borrowed(package.sha256) as renderer:
            self._warn_of_other(renderer.description, recorded_with)
            renderer.load_package(package.sha256, package.read, view.camera)
            if view.change is None:
                return renderer.render(view.pose, view.size)
            camera = changed_camera(recorded_camera(view.camera, view.size), view.change)
            image = renderer.render_camera(camera, view.pose)
            return Frame(image.rgb, image.depth, image.ids)

    def render_camera(
        self, package: ScenePackage | AppearancePackage, camera: Camera, pose: Pose, recorded_with: str
    ) -> CameraImage:
        """Returns the image of a camera of a rig for a pose of base_link; arguments and errors as those of `render`."""
        with self._borrowed(package.sha256) as renderer:
            self._warn_of_other(renderer.description, recorded_with)
            renderer.load_package(package.sha256, package.read, CameraConfig())
            return renderer.render_camera(camera, pose)

    def omit_warnings(self) -> None:
        """Disables the warning about another renderer, for callers that measure and report the difference of frames."""
        self._warns = False

    @property
    def description(self) -> str:
        """Description of the renderer, as episodes record it."""
        with self._borrowed() as renderer:
            return renderer.description

    @property
    def prepared_scenes(self) -> list[tuple[object, ...]]:
        """For each idle rendering process, the SHA-256 of the scenes that it keeps prepared."""
        with self._returned:
            return [renderer.prepared for renderer in self._free]

    @contextmanager
    def _borrowed(self, sha256: str = "") -> Iterator[ProcessRenderer]:
        """Lends a renderer to one thread; prefers a renderer that has prepared the scene."""
        with self._returned:
            self._returned.wait_for(lambda: self._free or self._opened < self._most)
            places = sorted(range(len(self._free)), key=lambda place: sha256 not in self._free[place].prepared)
            renderer = self._free.pop(places[0]) if places else None
            self._opened += renderer is None
        try:
            renderer = renderer or self._open()
            yield renderer
        finally:
            with self._returned:
                if renderer is None or not renderer.is_open:
                    self._opened -= 1
                else:
                    self._free.append(renderer)
                self._returned.notify()

    def _open(self) -> ProcessRenderer:
        try:
            return open_apart(self._kind, kept_scenes=KEPT_SCENES)
        except WorldError as error:
            raise WorldError(f"{error}; {_REMEDY}") from error

    def _warn_of_other(self, here: str, recorded_with: str) -> None:
        if not self._warns or recorded_with in (here, *self._warned):
            return
        self._warned.add(recorded_with)
        remedy = "`factory verify --render` compares the frames with the recorded digests"
        import structlog  # slow to import, and needed only for this warning

        log = structlog.get_logger(__name__)
        log.warning("renderer_differs", recorded_with=recorded_with, here=here, remedy=remedy)


def _is_first_loader_worker() -> bool:
    """Returns whether this process logs warnings: of the worker processes of a DataLoader, only the first one does."""
    loading = sys.modules.get("torch.utils.data")
    worker = loading.get_worker_info() if loading else None
    return worker is None or worker.id == 0


_renderers: dict[tuple[int, str], SharedRenderer] = {}


def shared_renderer() -> SharedRenderer:
    """Returns the renderer of this process; `MINIVLA_RENDERER` chooses its type.

    Raises:
        UsageError: `MINIVLA_RENDERER` names no renderer; raised at the first frame.
    """
    kind = cast(RendererKind, read_renderer())
    return _renderers.setdefault((os.getpid(), kind), SharedRenderer(kind))
