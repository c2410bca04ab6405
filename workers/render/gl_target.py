"""Render targets of the OpenGL renderer: colour, ids, and a depth buffer that serves as the depth image.

The depth buffer stores near / depth as float, which has the relative precision of a float at all distances, so no
third image has to be rendered. Does not depend on scenes or shader programs.
"""

from __future__ import annotations

import ctypes
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from workers.geometry.camera import Perspective
from workers.geometry.faces import Face
from workers.render import DepthAndIds, Window

_GUARD = 3
"""Width of the viewport as a multiple of the target, which is at its centre. llvmpipe draws a triangle with a corner
outside the viewport at a third of the speed, and the part of a triangle outside the target at no cost."""
_ONTO_TARGET = np.array((1.0 / _GUARD, -1.0 / _GUARD, 1.0, 1.0))[:, None]
"""Scale to the centre of the viewport; y is mirrored, so the top row of an image is first in memory, where OpenGL
has the bottom row."""
_ALL_TARGETS: Any = ((True,) * 4,) * 2
_DEPTH_ONLY: Any = ((False,) * 4,) * 2
"""Write masks of colour and ids with which only depth is written. The type is `Any`, because the type stubs of moderngl
accept one mask only, not one for each image."""
_TEXTURE_2D, _LOWER_LEFT, _ZERO_TO_ONE = 0x0DE1, 0x8CA1, 0x935F
_DEPTH_COMPONENT32F, _DEPTH_COMPONENT, _FLOAT = 0x8CAC, 0x1902, 0x1406


def onto_target(clip: NDArray[np.float64], near_m: float) -> NDArray[np.float64]:
    """Returns the (4, 4) matrix, for column vectors, with which a `GlTarget` shows the image of `clip`.

    Its z is the near distance, so the division by w gives near / depth; it does not clip at the far plane.

    Args:
        clip: (4, 4) matrix from world to OpenGL clip space, for column vectors; its w is the depth in metres.
        near_m: near distance, metres.
    """
    matrix: NDArray[np.float64] = clip * _ONTO_TARGET
    matrix[2] = (0.0, 0.0, 0.0, near_m)
    return matrix


class GlTarget:
    """Images on the device; the context must be current in every call."""

    def __init__(self, context: moderngl.Context, width: int, height: int) -> None:
        """Creates the images and configures the context's depth test for them.

        Args:
            context: OpenGL 4.5 context, which must be current.
            width: width of the images, pixels.
            height: height of the images, pixels.
        """
        self._shape = shape = (width, height)
        depth = context.depth_texture(shape)
        call = _Functions()
        call.bind_texture(_TEXTURE_2D, depth.glo)  # moderngl supports 24-bit depth only
        call.tex_image(_TEXTURE_2D, 0, _DEPTH_COMPONENT32F, width, height, 0, _DEPTH_COMPONENT, _FLOAT, None)
        call.clip_control(_LOWER_LEFT, _ZERO_TO_ONE)
        context.depth_func = ">"
        self._depth, self._layers = depth, (context.texture(shape, 3), context.texture(shape, 1, dtype="u2"))
        self._images = context.framebuffer(self._layers, depth)

    def release(self) -> None:
        for held in (self._images, self._depth, *self._layers):
            held.release()

    def begin(self, window: Window | None = None) -> None:
        """Binds the images for drawing one whole view, and clears the depth buffer.

        Args:
            window: part of the images that is drawn; `None` for the whole images.
        """
        self._images.scissor = None if window is None else _box(window)  # type: ignore[assignment]
        self._images.viewport = _guarded(0, *self._shape)
        self._images.use()
        self._images.color_mask = _DEPTH_ONLY
        self._images.clear(depth=0.0)
        self._images.color_mask = _ALL_TARGETS

    def begin_face(self, face: Face) -> None:
        """Limits drawing to the place of a face in the images."""
        view = face.view
        self._images.scissor = (0, face.top, view.width, view.height)
        self._images.viewport = _guarded(face.top, view.width, view.height)

    def read_colour(self, channels: int = 3) -> NDArray[np.uint8]:
        """Returns the colour (height, width, channels), which is undefined in pixels without a surface.

        `read_depth_and_ids` sets these pixels to 0 if the array is passed to it.
        """
        width, height = self._shape
        rgb = np.empty((height, width, channels), np.uint8)
        self._images.read_into(rgb, components=channels, attachment=0)
        return rgb

    def read_depth_and_ids(
        self, view: Perspective, *beside: NDArray[np.uint8], window: Window | None = None
    ) -> DepthAndIds:
        """Returns depth and ids; sets ids and the images `beside` to 0 where no surface is within the clip range."""
        box = _box(window or Window(0, 0, self._shape[1], self._shape[0]))
        shape = box[3], box[2]
        depth, ids = np.empty(shape, np.float32), np.empty(shape, np.uint16)
        self._images.read_into(depth, box, components=1, attachment=-1, dtype="f4", alignment=1)
        self._images.read_into(ids, box, components=1, attachment=1, dtype="u2", alignment=1)
        near, farthest = np.float32(view.near_m), _least_height(view)
        if depth.min() < farthest:
            void = np.flatnonzero(depth < farthest)
            depth.reshape(-1)[void] = np.inf  # the division below gives depth 0
            images: tuple[NDArray[Any], ...] = (ids, *beside)
            for image in images:
                image.reshape(depth.size, -1)[void] = 0
        np.divide(near, depth, out=depth)
        return DepthAndIds(depth, ids)


def _guarded(top: int, width: int, height: int) -> tuple[int, int, int, int]:
    """Returns the viewport of an image of this size, whose first row in the target is `top` and first column is 0.

    The image is in the centre of the viewport, which is larger than the target; see `_GUARD`.
    """
    beside = _GUARD // 2
    return -width * beside, top - height * beside, width * _GUARD, height * _GUARD


def _box(window: Window) -> tuple[int, int, int, int]:
    """Returns a window in OpenGL's form: x, y, width, height; the top row of an image is y = 0, see `onto_target`."""
    return window.left, window.top, window.right - window.left, window.bottom - window.top


def _least_height(view: Perspective) -> np.float32:
    """Returns the smallest value in the depth buffer whose depth, rounded to float32, is within the clip range."""
    near, far = np.float32(view.near_m), np.float32(view.far_m)
    height = near / far
    return height if near / height <= far else np.nextafter(height, np.float32(np.inf))


class _Functions:
    """OpenGL functions that moderngl does not provide, loaded through libEGL."""

    def __init__(self) -> None:
        egl = ctypes.CDLL("libEGL.so.1")
        egl.eglGetProcAddress.restype = ctypes.c_void_p
        egl.eglGetProcAddress.argtypes = (ctypes.c_char_p,)
        enum, integer, pointer = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p

        def function(name: bytes, *arguments: type) -> Any:
            return ctypes.CFUNCTYPE(None, *arguments)(egl.eglGetProcAddress(name))

        self.bind_texture = function(b"glBindTexture", enum, enum)
        self.tex_image = function(
            b"glTexImage2D", enum, integer, integer, integer, integer, integer, enum, enum, pointer
        )
        self.clip_control = function(b"glClipControl", enum, enum)
