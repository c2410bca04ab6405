"""What the OpenGL renderer draws onto: colour, ids, and a depth buffer that is the depth image.

The depth buffer holds near / depth in floats, which tells distances apart as finely as a float does, near and far; so
that no third image has to be drawn. Knows neither scenes nor programs.
"""

from __future__ import annotations

import ctypes
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from workers.render import DepthAndIds

__all__ = ["GlTarget", "onto_target"]

_GUARD = 3
"""The viewport is so many times as wide as the target, which is its middle: llvmpipe draws what has a corner beyond the
viewport at a third of the speed, and what is beyond the target at no cost."""
_ONTO_TARGET = np.array((1.0 / _GUARD, -1.0 / _GUARD, 1.0, 1.0))[:, None]
"""Into the middle of the viewport, and mirrored, so that an image's top row comes first in memory, where OpenGL has the
bottom row."""
_ALL_TARGETS: Any = ((True,) * 4,) * 2
_DEPTH_ONLY: Any = ((False,) * 4,) * 2
"""Masks of colour and ids; moderngl's types know only that of one target."""
_TEXTURE_2D, _LOWER_LEFT, _ZERO_TO_ONE = 0x0DE1, 0x8CA1, 0x935F
_DEPTH_COMPONENT32F, _DEPTH_COMPONENT, _FLOAT = 0x8CAC, 0x1902, 0x1406


def onto_target(clip: NDArray[np.float64], camera: CameraConfig) -> NDArray[np.float64]:
    """Returns the (4, 4) matrix, for columns, with which a `GlTarget` shows what `clip` shows.

    Its z is the near distance, so that near / depth is left after the division by w; the far plane cuts nothing.

    Args:
        clip: (4, 4) from world to OpenGL clip space, for columns; its w is the depth in metres.
        camera: gives the near distance.
    """
    matrix: NDArray[np.float64] = clip * _ONTO_TARGET
    matrix[2] = (0.0, 0.0, 0.0, camera.near_m)
    return matrix


class GlTarget:
    """Square images on the device; the context must be current in every call."""

    def __init__(self, context: moderngl.Context, size: int) -> None:
        """Makes the images and sets up the context's depth test for them.

        Args:
            context: current, of OpenGL 4.5.
            size: width and height, pixels.
        """
        self._size = size
        shape = (size, size)
        depth = context.depth_texture(shape)
        call = _Functions()
        call.bind_texture(_TEXTURE_2D, depth.glo)  # moderngl knows depth of 24 bits only
        call.tex_image(_TEXTURE_2D, 0, _DEPTH_COMPONENT32F, size, size, 0, _DEPTH_COMPONENT, _FLOAT, None)
        call.clip_control(_LOWER_LEFT, _ZERO_TO_ONE)
        context.depth_func = ">"
        images = (context.texture(shape, 3), context.texture(shape, 1, dtype="u2"))
        self._images = context.framebuffer(images, depth)
        beside = size * (_GUARD // 2)
        self._images.viewport = (-beside, -beside, size * _GUARD, size * _GUARD)

    def begin(self) -> None:
        """Makes the images those that are drawn onto, and clears what tells where nothing is."""
        self._images.use()
        self._images.color_mask = _DEPTH_ONLY
        self._images.clear(depth=0.0)
        self._images.color_mask = _ALL_TARGETS

    def read_colour(self) -> NDArray[np.uint8]:
        """Returns (size, size, 3); where nothing is, what an earlier frame had there. `read_relief` blanks it."""
        rgb = np.empty((self._size, self._size, 3), np.uint8)
        self._images.read_into(rgb, components=3, attachment=0)
        return rgb

    def read_relief(self, camera: CameraConfig, *beside: NDArray[np.uint8]) -> DepthAndIds:
        """Returns depth and ids; blanks ids, and what was read `beside` them, where nothing is in the clip range."""
        shape = (self._size, self._size)
        depth, ids = np.empty(shape, np.float32), np.empty(shape, np.uint16)
        self._images.read_into(depth, components=1, attachment=-1, dtype="f4")
        self._images.read_into(ids, components=1, attachment=1, dtype="u2")
        near, farthest = np.float32(camera.near_m), _least_height(camera)
        if depth.min() < farthest:
            void = np.flatnonzero(depth < farthest)
            depth.reshape(-1)[void] = np.inf  # 0 when divided by
            images: tuple[NDArray[Any], ...] = (ids, *beside)
            for image in images:
                image.reshape(self._size * self._size, -1)[void] = 0
        np.divide(near, depth, out=depth)
        return DepthAndIds(depth, ids)


def _least_height(camera: CameraConfig) -> np.float32:
    """Returns what the depth buffer holds of the farthest surface whose depth, rounded, is within the clip range."""
    near, far = np.float32(camera.near_m), np.float32(camera.far_m)
    height = near / far
    return height if near / height <= far else np.nextafter(height, np.float32(np.inf))


class _Functions:
    """The functions of OpenGL that moderngl does not offer, from libEGL, which hands out all of them."""

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
