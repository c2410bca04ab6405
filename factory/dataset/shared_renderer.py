"""Renders frames of episodes for this process: one rendering process, shared by all threads and all episodes.

A forked process starts another rendering process. The module reads no bundles.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from typing import NamedTuple, cast

from factory.dataset.packages import ScenePackage
from factory.support.settings import read_renderer
from schemas.config import CameraConfig
from schemas.errors import WorldError
from schemas.rig import Camera
from schemas.scene import CompiledScene
from schemas.terms import RendererKind
from workers.geometry.pose import Pose
from workers.render import CameraImage, RenderedFrame, Renderer
from workers.render.choose import open_renderer

_KEPT_SCENES = 2
_REMEDY = (
    "the episode stores states, and its frames are rendered with OpenGL: on Debian `apt-get install libegl1 "
    "libgl1-mesa-dri`; MINIVLA_RENDERER=tiny uses PyBullet's TinyRenderer, whose colours differ"
)


class View(NamedTuple):
    """What determines a frame."""

    package: ScenePackage
    camera: CameraConfig
    pose: Pose
    size: int
    """Width and height, pixels."""


class SharedRenderer:
    """Renderer that is opened at the first frame; threads take turns.

    Args:
        kind: type of the renderer.
    """

    def __init__(self, kind: RendererKind) -> None:
        self._kind = kind
        self._turn = threading.Lock()
        self._renderer: Renderer | None = None
        self._scenes: OrderedDict[str, CompiledScene] = OrderedDict()
        self._last = threading.local()
        self._warned: set[str] = set()

    def render_once(self, view: View, recorded_with: str) -> RenderedFrame:
        """Returns the frame of a view as `render`, but renders it only once in a row for a thread; do not change it."""
        last: tuple[View, RenderedFrame] | None = getattr(self._last, "frame", None)
        if last is None or last[0] != view:
            last = self._last.frame = view, self.render(view, recorded_with)
        return last[1]

    def render(self, view: View, recorded_with: str) -> RenderedFrame:
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
        with self._turn:
            renderer = self._opened()
            self._warn_of_other(renderer.description, recorded_with)
            renderer.load(self._scene(view.package), view.camera)
            return renderer.render(view.pose, view.size)

    def render_camera(self, package: ScenePackage, camera: Camera, pose: Pose, recorded_with: str) -> CameraImage:
        """Returns the image of a camera of a rig for a pose of base_link; arguments and errors as those of `render`."""
        with self._turn:
            renderer = self._opened()
            self._warn_of_other(renderer.description, recorded_with)
            renderer.load(self._scene(package), CameraConfig())
            return renderer.render_camera(camera, pose)

    @property
    def description(self) -> str:
        """Description of the renderer, as episodes record it."""
        with self._turn:
            return self._opened().description

    def _scene(self, package: ScenePackage) -> CompiledScene:
        """Returns a decoded scene; the most recently used ones are kept by digest."""
        if package.sha256 not in self._scenes:
            scene = package.decode()
            while len(self._scenes) >= _KEPT_SCENES:
                self._scenes.popitem(last=False)
            self._scenes[package.sha256] = scene
        self._scenes.move_to_end(package.sha256)
        return self._scenes[package.sha256]

    def _opened(self) -> Renderer:
        if self._renderer is None:
            try:
                self._renderer = open_renderer(self._kind, apart=True)
            except WorldError as error:
                raise WorldError(f"{error}; {_REMEDY}") from error
        return self._renderer

    def _warn_of_other(self, here: str, recorded_with: str) -> None:
        if recorded_with in (here, *self._warned):
            return
        self._warned.add(recorded_with)
        remedy = "`factory verify --render` compares the frames with the recorded digests"
        import structlog  # not at the start of each process that reads a dataset, which it would slow down

        log = structlog.get_logger(__name__)
        log.warning("renderer_differs", recorded_with=recorded_with, here=here, remedy=remedy)


_renderers: dict[tuple[int, str], SharedRenderer] = {}


def shared_renderer() -> SharedRenderer:
    """Returns the renderer of this process; `MINIVLA_RENDERER` chooses its type.

    Raises:
        UsageError: `MINIVLA_RENDERER` names no renderer; raised at the first frame.
    """
    kind = cast(RendererKind, read_renderer())
    return _renderers.setdefault((os.getpid(), kind), SharedRenderer(kind))
