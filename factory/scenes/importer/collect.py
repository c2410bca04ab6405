"""Collects the parts of a scene from any file format: places pieces in the world and counts their triangles.

Also keeps names, labels and notes. Does not read files.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from factory.scenes.importer.content import Extraction, Part, Surface, TextureRecipe
from factory.scenes.limits import StageLimits
from schemas.errors import WorldError
from schemas.support.numpy_types import Floats


@dataclass(frozen=True)
class Piece:
    """Triangles with one material in their local frame; shared by all instances."""

    triangles: Floats
    """(T, 3, 3) corners, counter-clockwise from outside."""
    uvs: Floats | None
    """(T, 3, 2) texture coordinates, v = 0 at the bottom."""
    tints: Floats | None
    """(T, 3, 3) linear vertex colours."""
    surface: Surface

    def both_sides(self) -> Piece:
        """Adds the back face of every triangle, because the renderer culls back faces."""

        def doubled(values: Floats | None) -> Floats | None:
            return None if values is None else np.concatenate([values, values[:, ::-1]])

        both = np.concatenate([self.triangles, self.triangles[:, ::-1]])
        return replace(self, triangles=both, uvs=doubled(self.uvs), tints=doubled(self.tints))


@dataclass
class Collector:
    """Content of a scene while its file is read."""

    file: str
    limits: StageLimits
    notes: list[str] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    labels: dict[str, str] = field(default_factory=dict)
    groups: set[str] = field(default_factory=set)
    models: set[str] = field(default_factory=set)
    components: set[str] = field(default_factory=set)
    articulated: set[str] = field(default_factory=set)
    triangles: int = 0
    reader_version: str = ""
    """Version of the reader of the format, part of the digest; empty for readers that have not changed."""

    def require_room(self, path: str, more: int) -> None:
        """Checks that more triangles may be added.

        Raises:
            WorldError: the scene has more triangles than its limit; the message names the largest prims.
        """
        if self.triangles + more <= self.limits.max_triangles:
            return
        counts = Counter({path: more})
        counts.update({part.path: len(part.triangles) for part in self.parts})
        largest = ", ".join(f"{prim} ({count})" for prim, count in counts.most_common(3))
        raise WorldError(
            f"{self.file} has more than {self.limits.max_triangles} triangles, exceeded at prim {path}; the largest "
            f"prims so far are {largest}; decimate or deactivate them, split the stage, or raise --max-triangles if "
            "memory allows"
        )

    def place(self, path: str, pieces: Iterable[Piece], to_world: Floats, is_collider: bool = False) -> None:
        """Adds the pieces of a prim.

        Args:
            path: path of the prim, unique per instance.
            pieces: pieces of the prim.
            to_world: (4, 4) transform local frame -> world metres, for column vectors.
            is_collider: whether the prim is for collision only.

        Raises:
            ValueError: points or transform are not finite.
            WorldError: the scene has too many triangles.
        """
        chosen = [self._with_finite_uvs(path, piece) for piece in pieces]
        more = sum(len(piece.triangles) for piece in chosen)
        self.require_room(path, more)
        parts = [_placed(piece, path, to_world, is_collider) for piece in chosen]
        self.triangles += more
        self.parts += parts

    def _with_finite_uvs(self, path: str, piece: Piece) -> Piece:
        if piece.uvs is None or np.isfinite(piece.uvs).all():
            return piece
        self.notes.append(f"{path}: texture coordinates that are not finite are taken as 0")
        return replace(piece, uvs=np.nan_to_num(piece.uvs, posinf=0.0, neginf=0.0))

    def extraction(
        self,
        metres_per_unit: float,
        digests: Mapping[str, str],
        images: Mapping[str, bytes | TextureRecipe] = MappingProxyType({}),
    ) -> Extraction:
        """Returns the content.

        Args:
            metres_per_unit: length of the unit of the file, metres.
            digests: SHA-256 of the content of each file, by its path relative to the root file.
            images: encoded images inside other files, and textures to draw, by name.
        """
        ceiling_m = self.limits.ceiling_m
        added = [] if ceiling_m is None else [f"ceiling {ceiling_m}"]
        added += [] if self.limits.floor_m is None else [f"floor {self.limits.floor_m}"]
        added += [] if self.limits.unit is None else [f"unit {self.limits.unit}"]
        added += [] if self.limits.up is None else [f"up {self.limits.up}"]
        added += [self.reader_version] if self.reader_version else []
        return Extraction(
            parts=tuple(self.parts),
            metres_per_unit=metres_per_unit,
            labels=self.labels,
            groups=frozenset(self.groups),
            models=frozenset(self.models),
            components=frozenset(self.components),
            articulated=frozenset(self.articulated),
            sha256=_digest_of(sorted(digests.values()) + added),
            files_sha256=_digest_of(sorted(f"{place} {digest}" for place, digest in digests.items()) + added),
            notes=tuple(dict.fromkeys(self.notes)),
            floor_m=self.limits.floor_m,
            ceiling_m=ceiling_m,
            images=images,
        )


def _placed(piece: Piece, path: str, to_world: Floats, is_collider: bool) -> Part:
    rotation, shift = to_world[:3, :3], to_world[:3, 3]
    with np.errstate(all="ignore"):
        exact = piece.triangles @ rotation.T + shift
        # rounded to float32, because the last bit of the product depends on the processor (`schemas.support.portable`)
        triangles = exact.astype(np.float32).astype(np.float64)
    uvs, tints = piece.uvs, piece.tints
    if not np.isfinite(triangles).all():
        raise ValueError("points or transform are not finite")
    if np.linalg.det(rotation) < 0:  # mirroring reverses the winding
        triangles = triangles[:, ::-1]
        uvs = None if uvs is None else uvs[:, ::-1]
        tints = None if tints is None else tints[:, ::-1]
    return Part(path, triangles, uvs=uvs, tints=tints, surface=piece.surface, is_collider=is_collider)


def _digest_of(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
