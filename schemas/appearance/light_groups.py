"""Light groups of a compiled scene: the share of each lamp group in the baked light. Model and codec; bakes nothing.

The groups are stored in a file beside the package, so packages and their digests do not depend on them.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Annotated, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from schemas.base import Count, Line, Model, Sha256
from schemas.encoding.container import ContainerLimits, ContainerReader, ContainerWriter
from schemas.encoding.ndarray import decode_npy_zst, encode_npy_zst
from schemas.errors import InvalidBundle
from schemas.scene import MAX_LIGHT_MAP_PX

LIGHT_FORMAT = 1
"""Version of the file and of the method that computes it; a reader opens files of this version only."""
SCREENS = "screens"
"""Kind of the group of small bright surfaces, whose light is not varied."""
MAX_GROUPS = 16
"""Largest number of lamp groups."""
_MAX_BYTES = (MAX_GROUPS + 1) * MAX_LIGHT_MAP_PX**2
_LIMITS = ContainerLimits(members=4, member_bytes=_MAX_BYTES)


class LampGroup(Model):
    """Lamps that are switched together."""

    kind: Line
    """`lamps` for surfaces that shine down; `windows` for large bright surfaces at any other angle, `screens` for
    small ones."""
    lamps: Annotated[int, Field(ge=1)]
    """Number of lamps."""
    centre_m: tuple[float, float, float]
    """Mean position in the world frame, metres."""


class LightGroupsInfo(Model):
    """JSON metadata of the light groups of a scene."""

    format: Count = LIGHT_FORMAT
    """Version of the file."""
    scene_sha256: Sha256
    """Digest of the package."""
    groups: Annotated[tuple[LampGroup, ...], Field(max_length=MAX_GROUPS)]
    """Lamp groups, in the order of the shares."""


@dataclass(frozen=True)
class LightGroups:
    """Composition of the baked light of a scene."""

    info: LightGroupsInfo
    """Metadata of the groups."""
    shares: NDArray[np.uint8]
    """(K + 1, H, W) composition of the light of each texel: first the share of the sky and of indirect light, then that
    of each of the K lamp groups. The shares of a texel add up to 255."""


def encode_light_groups(light: LightGroups) -> bytes:
    """Returns the file of the light groups of a scene; equal groups give equal bytes with the same compressor."""
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        out.add("light.json", light.info.model_dump_json(indent=1).encode())
        out.add("shares.npy.zst", encode_npy_zst(light.shares))
    return buffer.getvalue()


def decode_light_groups(file: BinaryIO) -> LightGroups:
    """Decodes the light groups of a scene from a seekable file.

    Raises:
        InvalidBundle: the file is damaged or has a different format version.
    """
    reader = ContainerReader(file, _LIMITS)
    try:
        info = LightGroupsInfo.model_validate_json(reader.read("light.json"))
    except ValidationError as error:
        raise InvalidBundle("light groups refused", [item["msg"] for item in error.errors()]) from error
    if info.format != LIGHT_FORMAT:
        raise InvalidBundle("light groups refused", [f"format {info.format}, this software reads {LIGHT_FORMAT}"])
    shape = (len(info.groups) + 1, None, None)
    shares = decode_npy_zst("shares", reader.read("shares.npy.zst"), dtype=np.uint8, shape=shape, max_bytes=_MAX_BYTES)
    if shares.size and (shares.sum(axis=0, dtype=np.uint32) != 255).any():
        raise InvalidBundle("light groups refused", ["the shares of a texel do not add up to 255"])
    return LightGroups(info, np.asarray(shares, np.uint8))
