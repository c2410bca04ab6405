"""Content digests: XXH3-128 over decoded frames, arrays and canonical metadata, so that no compressor build matters.

Guards identity, not malice; the SHA-256 of the file guards storage and transfer.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence

import numpy as np
import xxhash
from numpy.typing import NDArray

__all__ = ["content_digest", "dataset_digest", "frame_digest"]


def frame_digest(rgb: NDArray[np.uint8], depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> str:
    """Returns the digest of one frame as 32 hexadecimal digits."""
    digest = xxhash.xxh3_128()
    for image in (rgb, depth, ids):
        digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()


def content_digest(frame_digests: Sequence[str], arrays: Iterable[NDArray[np.generic]], canonical_meta: str) -> str:
    """Returns the digest of an episode.

    Args:
        frame_digests: of every frame, in order.
        arrays: the episode's arrays in the order of `schemas.encoding.arrays.EPISODE_ARRAYS`.
        canonical_meta: `EpisodeMeta.canonical()`.
    """
    digest = xxhash.xxh3_128()
    digest.update("".join(frame_digests).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    digest.update(canonical_meta.encode())
    return digest.hexdigest()


def dataset_digest(episodes: Iterable[tuple[str, str]]) -> str:
    """Returns one SHA-256 over (episode id, content digest) pairs, whatever their order."""
    lines = "".join(f"{name} {digest}\n" for name, digest in sorted(episodes))
    return hashlib.sha256(lines.encode()).hexdigest()
