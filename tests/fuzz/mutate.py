"""Damages a file in ways that often break parsers. The result depends only on the arguments."""

from __future__ import annotations

import io
import random
import zipfile
from collections.abc import Callable, Sequence

_TOKENS = (
    *(
        b"\x00",
        b"\xff" * 8,
        b"-1",
        b"0",
        b"1e309",
        b"NaN",
        b"-Infinity",
        b"9" * 40,
        b'"',
        b"[" * 50,
        b"{" * 50,
        b"]",
        b"}",
    ),
    *(
        b"null",
        b"true",
        b"../",
        b"\xed\xa0\x80",
        b"\\u0000",
        b"\n",
        b"=",
        b"'''",
        b"1979-05-27",
        b"[[",
        b"inf",
        b"@",
        b"<",
    ),
)
_MOST_BYTES = 1 << 20


def mutate(rng: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Returns a file that is damaged in one to six ways."""
    for _ in range(rng.randint(1, 6)):
        data = rng.choice(_DAMAGES)(rng, data, others)
    return data[:_MOST_BYTES]


def mutate_members(rng: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Damages a member of a zip file and keeps the container valid, or damages the whole file."""
    if rng.random() < 0.4:
        return mutate(rng, data, others)
    with zipfile.ZipFile(io.BytesIO(data)) as source:
        members = [(info.filename, source.read(info)) for info in source.infolist()]
    victim = rng.randrange(len(members))
    if rng.random() < 0.5:  # the small members (metadata, arrays) have most structure
        victim = rng.choice(sorted(range(len(members)), key=lambda at: len(members[at][1]))[:8])
    name, content = members[victim]
    members[victim] = (name, mutate(rng, content, [each for _, each in members]))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as target:
        for name, content in members:
            target.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content)
    return out.getvalue()


def _flip(rng: random.Random, data: bytes, _others: Sequence[bytes]) -> bytes:
    if not data:
        return data
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]


def _number(rng: random.Random, data: bytes, _others: Sequence[bytes]) -> bytes:
    """Overwrites bytes with a large, small or negative number."""
    width = rng.choice((1, 2, 4, 8))
    value = rng.choice(
        (0, 1, 2**31 - 1, 2**32 - 1, 2 ** (8 * width - 1), 2 ** (8 * width) - 1, rng.getrandbits(8 * width))
    )
    at = rng.randrange(len(data) + 1)
    return data[:at] + (value % 2 ** (8 * width)).to_bytes(width, "little") + data[at + width :]


def _insert(rng: random.Random, data: bytes, _others: Sequence[bytes]) -> bytes:
    at = rng.randrange(len(data) + 1)
    return data[:at] + rng.choice(_TOKENS) * rng.choice((1, 1, 1, 40)) + data[at:]


def _replace_word(rng: random.Random, data: bytes, _others: Sequence[bytes]) -> bytes:
    """Replaces the word between two separators, so a text file remains readable text."""
    marks = [at for at, byte in enumerate(data) if byte in b' ,:="()[]{}\n'][:100_000]
    if len(marks) < 2:
        return data
    number = rng.randrange(len(marks) - 1)
    return data[: marks[number] + 1] + rng.choice(_TOKENS) + data[marks[number + 1] :]


def _cut(rng: random.Random, data: bytes, _others: Sequence[bytes]) -> bytes:
    start = rng.randrange(len(data) + 1)
    return data[:start] + data[start + rng.choice((1, 4, 64, len(data))) :]


def _double(rng: random.Random, data: bytes, _others: Sequence[bytes]) -> bytes:
    start = rng.randrange(len(data) + 1)
    part = data[start : start + rng.choice((4, 64, 1024))]
    return data[:start] + part * rng.choice((2, 2, 50)) + data[start:]


def _splice(rng: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others) if others else data
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]


_DAMAGES: tuple[Callable[[random.Random, bytes, Sequence[bytes]], bytes], ...] = (
    _flip,
    _number,
    _insert,
    _replace_word,
    _replace_word,
    _cut,
    _double,
    _splice,
)
