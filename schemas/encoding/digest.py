"""Content digests: XXH3-128 over decoded frames, arrays and canonical metadata, independent of the compressor.

They identify content and do not protect against deliberate changes; the SHA-256 of the file protects storage and
transfer.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence

import numpy as np
import xxhash
from numpy.typing import NDArray


def frame_digest(rgb: NDArray[np.uint8], depth: NDArray[np.float32], ids: NDArray[np.uint16]) -> str:
    """Returns the digest of one frame as 32 hexadecimal digits.

    Args:
        rgb: (H, W, 3) sRGB.
        depth: (H, W) metres.
        ids: (H, W) instance ids.
    """
    digest = xxhash.xxh3_128()
    for image in (rgb, depth, ids):
        digest.update(np.ascontiguousarray(image).data)
    return digest.hexdigest()


def content_digest(frame_digests: Sequence[str], arrays: Iterable[NDArray[np.generic]], canonical_meta: str) -> str:
    """Returns the content digest of an episode as 32 hexadecimal digits.

    Args:
        frame_digests: digests of all frames, in order.
        arrays: arrays of the episode in the order of `schemas.encoding.arrays.EPISODE_ARRAYS`.
        canonical_meta: result of `EpisodeMeta.canonical()`.
    """
    # from frame digests, so a damaged frame can be found without decoding the others; from decoded arrays and without
    # provenance, so the digest depends neither on the build of the compressor nor on the worker
    digest = xxhash.xxh3_128()
    digest.update("".join(frame_digests).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    digest.update(canonical_meta.encode())
    return digest.hexdigest()


def dataset_digest(episodes: Iterable[tuple[str, str]], *, is_sorted: bool = False) -> str:
    """Returns the SHA-256 over (episode id, content digest) pairs; their order does not matter.

    Args:
        episodes: the pairs.
        is_sorted: whether the pairs are in ascending order; otherwise this function sorts them in memory.
    """
    digest = hashlib.sha256()
    for name, content in episodes if is_sorted else sorted(episodes):
        digest.update(f"{name} {content}\n".encode())
    return digest.hexdigest()
