"""Formats names and numbers of figures, captions and tables. Pure functions."""

from __future__ import annotations

from factory.stats.statistics import Share

DASH = "–"


def count(n: int, noun: str) -> str:
    """Returns `1 episode`, `12 episodes`."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def name(identifier: str) -> str:
    """Returns an identifier with spaces instead of underscores."""
    return identifier.replace("_", " ")


def scene_label(scene: str) -> str:
    """Returns the name of a scene for an axis label; a long name has two lines."""
    words = scene.split("_")
    half = (len(words) + 1) // 2
    return scene if len(scene) < 12 else " ".join(words[:half]) + "\n" + " ".join(words[half:])


def file_part(identifier: str) -> str:
    """Returns an identifier in the form used in file names."""
    return "".join(letter if letter.isalnum() or letter in "_-" else "_" for letter in identifier)


def number(value: float | None, digits: int = 2) -> str:
    """Returns a number with a given number of decimals, or a dash for `None`."""
    return DASH if value is None else f"{value:.{digits}f}".replace("-", "−")


def percent(share: float | None, digits: int = 1) -> str:
    """Returns a share in per cent, or a dash for `None`."""
    return DASH if share is None else f"{100 * share:.{digits}f} %"


def interval(share: Share) -> str:
    """Returns a share with its interval in per cent: `13 % (9–18)`; a dash without data."""
    if share.low is None or share.high is None:
        return DASH
    return f"{percent(share.share, 0)} ({100 * share.low:.0f}–{100 * share.high:.0f})"
