"""Formats diagnostics of USD as single lines that are equal on every machine and in every run.

Removes memory addresses and directories, which would make two imports of one stage differ. If the notes were excluded
from the digest instead, packages with the same digest would have different bytes. Does not call USD.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

_LONGEST = 300
_MOST_KINDS = 5
_VARYING = re.compile(r"<[^>]*>|@[^@]*@|'[^']*'|\"[^\"]*\"|/[\w/.:\[\]-]+|\d+")
_NOISE = (
    re.compile(r"\s*\(\w+ stage on stage @[^@]*@ <0x[0-9a-f]+>\)"),
    re.compile(r",@anon:0x[0-9a-f]+:[^@]*@"),  # the anonymous session layer
    re.compile(r"pxrInternal_\w*?::"),
    re.compile(r"(?<=<)/[^<>]*/(?=[^<>/]+\.usd[acz]?>)"),
    re.compile(r"^/\S*/(?=[^/\s]+:\d+)"),
    re.compile(r"\s*<?0x[0-9a-f]{6,}>?"),
)
_ASSET = re.compile(r"@([^@]*)@")
_REMEDIES = (
    ("cycle", "remove the circular reference"),
    ("could not open asset", "add the file or remove the reference"),
    ("could not load sublayer", "add the file or remove the sublayer"),
)


def text_of(read: Callable[[], str]) -> str:
    """Returns a message of USD; replaces bytes that are not UTF-8, which quoted files may contain."""
    try:
        return read()
    except UnicodeDecodeError as error:
        return error.object.decode(errors="replace")


def format_warning(text: str) -> str:
    """Formats a warning of USD as one line, with file names instead of paths and a remedy if one is known.

    Args:
        text: commentary of a diagnostic.
    """
    line = _plain(text)
    remedies = (remedy for words, remedy in _REMEDIES if words in line.lower())
    remedy = next(remedies, "")
    return f"{line[:_LONGEST].rstrip(' .;')}; {remedy}" if remedy else line[:_LONGEST]


def summarise(warnings: Sequence[str]) -> list[str]:
    """Returns one line for each kind of warning: its first text, and the number of similar ones.

    Warnings that differ only in prims, files, quoted names or numbers are of one kind. The last line counts the kinds
    that are not listed.

    Args:
        warnings: formatted warnings, sorted.
    """
    kinds: dict[str, list[str]] = {}
    for line in warnings:
        kinds.setdefault(_VARYING.sub("#", line), []).append(line)
    lines = [
        first if not others else f"{first} ({len(others)} similar warnings of OpenUSD)"
        for first, *others in list(kinds.values())[:_MOST_KINDS]
    ]
    rest = sum(map(len, list(kinds.values())[_MOST_KINDS:]))
    return [*lines, f"{rest} other warnings of OpenUSD"] if rest else lines


def format_error(text: str) -> str:
    """Formats an error of USD as one line: the first error of the list, which is the root cause.

    Args:
        text: text of a `Tf.ErrorException`: errors, each with its location in the source of USD.
    """
    errors = [part.partition(" : '")[2].strip().removesuffix("'") for part in text.split("\n\tError in ") if part]
    return _plain(next((error for error in errors if error), text))[:_LONGEST]


def _plain(text: str) -> str:
    line = " ".join(text.split())
    for noise in _NOISE:
        line = noise.sub("", line)
    return _ASSET.sub(lambda asset: f"@{_file_name(asset.group(1))}@", line)


def _file_name(asset: str) -> str:
    """Returns the file name of an asset path, with its path in a package: `a/b.usdz[c/d.png]` is `b.usdz[c/d.png]`."""
    file, bracket, packed = asset.partition("[")
    return file.rpartition("/")[2] + bracket + packed
