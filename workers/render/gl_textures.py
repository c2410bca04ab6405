"""Texture arrays of scenes on the graphics device. Layers of another scene are copied with their mipmaps.

Generating the mipmaps of a layer takes 3 ms of CPU time with llvmpipe, and the layouts of a family share most layers.
moderngl has no function that copies between textures, so three functions of OpenGL are called directly. One array for
all scenes would copy every layer whenever it grows.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import moderngl
import numpy as np

from schemas.scene import Layer

_EGL = "libEGL.so.1"
_TEXTURE_2D_ARRAY, _RGB8 = 0x8C1A, 0x8051


class LayerArray:
    """Texture array of one scene, with the layers that it contains."""

    def __init__(self, array: moderngl.TextureArray, layers: Sequence[Layer], forget: Callable[[LayerArray], None]):
        self.array = array
        self.layers = [weakref.ref(layer) for layer in layers]
        self._forget = forget

    def use(self, unit: int) -> None:
        self.array.use(unit)

    def release(self) -> None:
        self._forget(self)
        self.array.release()


class TextureStore:
    """Texture arrays of the prepared scenes of one context."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._functions = _Functions()
        self._arrays: list[LayerArray] = []

    def upload(self, layers: Sequence[Layer]) -> LayerArray:
        """Returns an array with layers (512, 512, 3); rows are reversed, because v = 0 is the bottom row.

        Only the nearest mipmap is sampled: interpolation between two mipmaps would not improve the image quality here,
        and would take as much additional time as sampling the light map.
        """
        layers = layers or (np.full((1, 1, 3), 255, np.uint8),)
        sources = self._find(layers)
        if any(source is not None for source in sources):
            array = self._combine(layers, sources)
        else:
            array = self._generate(layers)
        array.filter = (moderngl.LINEAR_MIPMAP_NEAREST, moderngl.LINEAR)
        stored = LayerArray(array, layers, self._arrays.remove)
        self._arrays.append(stored)
        return stored

    def _find(self, layers: Sequence[Layer]) -> list[tuple[moderngl.TextureArray, int] | None]:
        """Returns the array that contains each layer, and the layer's index in it; `None` for new layers."""
        known: dict[int, tuple[moderngl.TextureArray, int]] = {}
        for stored in self._arrays:
            for place, reference in enumerate(stored.layers):
                layer = reference()
                if layer is not None:  # the layer exists, so no other object has its id
                    known[id(layer)] = stored.array, place
        return [known.get(id(layer)) for layer in layers]

    def _generate(self, layers: Sequence[Layer]) -> moderngl.TextureArray:
        """Returns a new array with the layers and their mipmaps."""
        height, width, _ = layers[0].shape
        array = self._context.texture_array((width, height, len(layers)), 3)
        for number, layer in enumerate(layers):
            array.write(np.ascontiguousarray(layer[::-1]), (0, 0, number, width, height, 1))
        array.build_mipmaps()
        return array

    def _combine(
        self, layers: Sequence[Layer], sources: Sequence[tuple[moderngl.TextureArray, int] | None]
    ) -> moderngl.TextureArray:
        """Returns a new array with the layers, copied from other arrays as far as possible."""
        height, width, _ = layers[0].shape
        array = self._context.texture_array((width, height, 1), 3)  # `allocate` reserves memory for all mipmap levels
        levels = max(width, height).bit_length()
        gl = self._functions
        array.use(0)
        gl.allocate(_TEXTURE_2D_ARRAY, levels, _RGB8, width, height, len(layers))
        missing = [number for number, source in enumerate(sources) if source is None]
        made = self._generate([layers[number] for number in missing]) if missing else None
        for number, source in enumerate(sources):
            other, place = (made, missing.index(number)) if source is None else source
            assert other is not None
            for level in range(levels):
                size = max(1, width >> level), max(1, height >> level), 1
                here, there = (array.glo, _TEXTURE_2D_ARRAY, level, 0, 0, number), (other.glo, _TEXTURE_2D_ARRAY, level)
                gl.copy(*there, 0, 0, place, *here, *size)
        if made is not None:
            made.release()
        return array


class _Functions:
    """Functions of OpenGL 4.5 that moderngl does not offer."""

    def __init__(self) -> None:
        find: Any = ctypes.CDLL(_EGL).eglGetProcAddress
        find.restype, find.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
        unsigned, signed = ctypes.c_uint, ctypes.c_int
        allocation = ctypes.CFUNCTYPE(None, unsigned, signed, unsigned, signed, signed, signed)
        self.allocate = allocation(find(b"glTexStorage3D"))
        one = (unsigned, unsigned, *(signed,) * 4)
        self.copy = ctypes.CFUNCTYPE(None, *one, *one, signed, signed, signed)(find(b"glCopyImageSubData"))
