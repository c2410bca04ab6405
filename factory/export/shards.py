"""Divides the pieces of a split into shards, and joins the files of pieces. Independent of the format of a shard."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from factory.export.base import EpisodeFacts, ExportPiece


class ShardFacts(EpisodeFacts):
    """Facts of a piece that are needed to divide the pieces into shards."""

    member_bytes: int
    """Size of the piece in a shard, bytes."""


class Shard(NamedTuple):
    """Shard with its pieces."""

    pieces: tuple[ExportPiece[ShardFacts], ...]
    samples: int
    """Number of frames."""
    size: int
    """Size of the pieces, bytes."""


def shards_of(pieces: Sequence[ExportPiece[ShardFacts]], limit_bytes: int) -> Iterator[Shard]:
    """Yields the shards of a split: pieces in a fixed pseudo-random order; a new shard begins when one is full.

    The order of the plan groups episodes by scene; shuffling mixes scenes within a shard.
    """
    chosen: list[ExportPiece[ShardFacts]] = []
    samples = size = 0
    for piece in sorted(pieces, key=lambda piece: hashlib.sha256(piece.episode_id.encode()).digest()):
        facts = piece.facts
        chosen.append(piece)
        samples, size = samples + facts.frames, size + facts.member_bytes
        if size >= limit_bytes:
            yield Shard(tuple(chosen), samples, size)
            chosen, samples, size = [], 0, 0
    if chosen:
        yield Shard(tuple(chosen), samples, size)


def join_files(sources: Iterable[Path], target: Path, end: Callable[[int], bytes] = lambda _: b"") -> None:
    """Concatenates files, in bounded memory, and syncs the result.

    Args:
        sources: files to concatenate.
        target: file to write.
        end: function of the size of the concatenated files that returns the bytes to append.
    """
    with target.open("wb") as out:
        for source in sources:
            with source.open("rb") as data:
                shutil.copyfileobj(data, out, 1 << 20)
        out.write(end(out.tell()))
        out.flush()
        os.fsync(out.fileno())
