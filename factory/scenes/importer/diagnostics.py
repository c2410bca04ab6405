"""What USD complains about, in one line each: the same words on every machine and at every run.

Its own words hold addresses of memory and places on disk; they would make two imports of one stage differ.
"""

from __future__ import annotations

import re
from collections.abc import Callable

__all__ = ["say_complaint", "say_refusal", "text_of"]

_LONGEST = 300
_NOISE = (
    re.compile(r"\s*\(\w+ stage on stage @[^@]*@ <0x[0-9a-f]+>\)"),
    re.compile(r",@anon:0x[0-9a-f]+:[^@]*@"),  # the layer of the session, which nobody wrote
    re.compile(r"pxrInternal_\w*?::"),
    re.compile(r"(?<=<)/[^<>]*/(?=[^<>/]+\.usd[acz]?>)"),
    re.compile(r"^/\S*/(?=[^/\s]+:\d+)"),
    re.compile(r"\s*<?0x[0-9a-f]{6,}>?"),
)
_ASSET = re.compile(r"@([^@]*)@")
_REMEDIES = (
    ("cycle", "take the reference out that leads back"),
    ("could not open asset", "put the file there or take the reference out"),
    ("could not load sublayer", "put the file there or take the sublayer out"),
)


def text_of(read: Callable[[], str]) -> str:
    """Returns words of USD's that may quote a file which is no UTF-8; bytes that are none are replaced."""
    try:
        return read()
    except UnicodeDecodeError as error:
        return error.object.decode(errors="replace")


def say_complaint(text: str) -> str:
    """Returns a warning of USD's as one line, files by their names, with what to do about it where that is known.

    Args:
        text: the commentary of a diagnostic.
    """
    line = _plain(text)
    remedies = (remedy for words, remedy in _REMEDIES if words in line.lower())
    remedy = next(remedies, "")
    return f"{line[:_LONGEST].rstrip(' .;')}; {remedy}" if remedy else line[:_LONGEST]


def say_refusal(text: str) -> str:
    """Returns why USD opens no stage, as one line: the first of its errors, which is the deepest.

    Args:
        text: of a `Tf.ErrorException`: errors, each with its place in USD's own source.
    """
    errors = [part.partition(" : '")[2].strip().removesuffix("'") for part in text.split("\n\tError in ") if part]
    return _plain(next((error for error in errors if error), text))[:_LONGEST]


def _plain(text: str) -> str:
    line = " ".join(text.split())
    for noise in _NOISE:
        line = noise.sub("", line)
    return _ASSET.sub(lambda asset: f"@{_file_name(asset.group(1))}@", line)


def _file_name(asset: str) -> str:
    """The file without its folder; what it packs keeps its place: `a/b.usdz[c/d.png]` becomes `b.usdz[c/d.png]`."""
    file, bracket, packed = asset.partition("[")
    return file.rpartition("/")[2] + bracket + packed
