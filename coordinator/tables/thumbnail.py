"""Creates the thumbnail of an episode: frame 0 in colour as a small JPEG. Reads one frame and writes no file."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from schemas.bundle import BundleReader
from schemas.encoding.arrays import FRAME_SIZE_PX
from schemas.errors import InvalidBundle
from schemas.storage.place import Place

__all__ = ["THUMBNAIL_PX", "read_thumbnail", "shrink_frame"]

THUMBNAIL_PX = 160
"""Width and height of a thumbnail, pixels: a quarter of the frame size."""
_QUALITY = 85


def read_thumbnail(bundle: Place, steps: int) -> bytes | None:
    """Returns the thumbnail of an episode, or `None` if its file is missing or its first frame is unreadable.

    Args:
        bundle: path of the episode file.
        steps: number of steps of the episode.

    Raises:
        WorldError: the store does not respond.
    """
    try:
        with bundle.open("rb") as file, BundleReader(file, steps) as reader:
            return shrink_frame(reader.rgb(0))
    except (InvalidBundle, OSError):
        return None


def shrink_frame(rgb: NDArray[np.uint8]) -> bytes:
    """Returns a (640, 640, 3) sRGB frame as a JPEG of 160 x 160 pixels, each the mean of 4 x 4 pixels."""
    small = Image.fromarray(rgb).reduce(FRAME_SIZE_PX // THUMBNAIL_PX)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=_QUALITY)
    return buffer.getvalue()
