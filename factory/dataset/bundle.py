"""Reads the bundle of an archived episode and renders the frames that it does not store. Writes nothing."""

from __future__ import annotations

import re
from functools import cached_property
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from factory.dataset.packages import ScenePackage
from factory.dataset.rendering import AppearancePackage, View, drawn_for, shared_renderer, shrink_frame
from schemas.appearance import Appearance, DrawnAppearance
from schemas.bundle import BundleReader, encode_depth
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.encoding.png import encode_png
from schemas.frame import Frame
from schemas.rig import Camera
from schemas.scene import Instance
from schemas.storage.place import Place
from workers.appearance import clutter_instances
from workers.geometry.pose import Pose
from workers.render import CameraImage

if TYPE_CHECKING:
    from workers.sensors.rays import SceneRays

_FRAME_MEMBER = re.compile(r"(rgb_front|depth_front|seg_front)/(\d{6})\.\w+(\.zst)?")


class EpisodeBundle(BundleReader):
    """Bundle of a dataset; the frames of a states recording are rendered when they are read.

    Args:
        file: seekable file, opened for reading.
        root: location of the dataset, which contains the scenes.
        steps: number of steps of the episode, see `BundleReader`.
        ranges: appearance of rendered frames; `None` renders the scene as it was compiled.
    """

    def __init__(self, file: BinaryIO, root: Place, steps: int | None = None, ranges: Appearance | None = None) -> None:
        super().__init__(file, steps)
        self._root, self._ranges = root, ranges

    @cached_property
    def appearance(self) -> DrawnAppearance | None:
        """Factors of the appearance: recorded with the frames, or drawn for frames that are rendered."""
        if self.meta.appearance is not None or self._ranges is None:
            return self.meta.appearance
        return drawn_for(self._ranges, self.meta.job, self.package, self.arrays.poses)

    @cached_property
    def shown(self) -> ScenePackage | AppearancePackage:
        """Scene of the episode with its appearance."""
        drawn = self.appearance
        return self.package if drawn is None or not drawn.changes_scene else AppearancePackage(self.package, drawn)

    @property
    def package(self) -> ScenePackage:
        """Scene of the episode."""
        job = self.meta.job
        return ScenePackage(self._root, job.scene, job.scene_sha256)

    @property
    def instances(self) -> tuple[Instance, ...]:
        """Instances that the ids refer to, from the metadata or the scene."""
        if self.has_frames:
            return self.meta.instances
        known, drawn = self.package.info().instances, self.appearance
        clutter = () if drawn is None else clutter_instances([item.id for item in known], drawn.clutter)
        return (*known, *clutter)

    def render(self, t: int, size: int = FRAME_SIZE_PX, antialias: int = 1) -> Frame:
        """Renders frame t from its pose; equal to the recorded frame if renderer and size are equal.

        Args:
            t: step.
            size: width and height, pixels.
            antialias: samples per pixel along each axis; colours are their mean, depth and ids are those of
                the middle sample.

        Raises:
            ArchiveCorrupt: the scene package is missing or was changed.
            UsageError: `size * antialias` is larger than the renderer supports.
            WorldError: this machine cannot render.
        """
        return shrink_frame(shared_renderer().render(*self._view(t, size * antialias)), antialias)

    def render_camera(self, pose: Pose, camera: Camera) -> CameraImage:
        """Renders the image of a camera of a rig from a pose of base_link; raises the errors of `render`."""
        recorded_with = self.meta.provenance.fingerprint.renderer
        return shared_renderer().render_camera(self.shown, camera, pose, recorded_with)

    def rays(self) -> SceneRays:
        """Returns the ray caster of the scene; raises the errors of `ScenePackage.rays`."""
        return self.shown.rays()

    def _view(self, t: int, size: int = FRAME_SIZE_PX) -> tuple[View, str]:
        change = None if self.appearance is None else self.appearance.camera
        view = View(self.shown, self.meta.job.camera, pose=Pose.of(self.arrays.poses[t]), size=size, change=change)
        return view, self.meta.provenance.fingerprint.renderer

    def _rendered(self, t: int) -> Frame:
        return shared_renderer().render_once(*self._view(t))

    def rgb(self, t: int) -> NDArray[np.uint8]:
        """Returns frame t as (640, 640, 3) sRGB."""
        return super().rgb(t) if self.has_frames else self._rendered(t).rgb.copy()

    def depth(self, t: int) -> NDArray[np.float32]:
        """Returns frame t as (640, 640) metres along the optical axis, 0 where nothing was hit."""
        return super().depth(t) if self.has_frames else self._rendered(t).depth.copy()

    def ids(self, t: int) -> NDArray[np.uint16]:
        """Returns frame t as (640, 640) instance ids."""
        return super().ids(t) if self.has_frames else self._rendered(t).ids.copy()

    def stored(self, name: str) -> bytes:
        """Returns the bytes of a member as a recording of frames stores it.

        For a states recording, frames are rendered and encoded.
        """
        of_frame = None if self.has_frames else _FRAME_MEMBER.fullmatch(name)
        if of_frame is None:
            return super().stored(name)
        frame = self._rendered(int(of_frame[2]))
        if of_frame[1] == "depth_front":
            return encode_depth(frame.depth)
        return encode_png(frame.rgb if of_frame[1] == "rgb_front" else frame.ids)
