"""How names and numbers are written in figures, captions and tables. Pure text."""

from __future__ import annotations

__all__ = ["DASH", "count", "file_part", "name", "number", "percent", "scene_label"]

DASH = "–"


def count(n: int, noun: str) -> str:
    """Returns `1 episode`, `12 episodes`."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def name(identifier: str) -> str:
    """Returns an identifier as words."""
    return identifier.replace("_", " ")


def scene_label(scene: str) -> str:
    """Returns a scene's name on two lines where it is long, for an axis."""
    words = scene.split("_")
    half = (len(words) + 1) // 2
    return scene if len(scene) < 12 else " ".join(words[:half]) + "\n" + " ".join(words[half:])


def file_part(identifier: str) -> str:
    """Returns an identifier as part of a file name."""
    return "".join(letter if letter.isalnum() or letter in "_-" else "_" for letter in identifier)


def number(value: float | None, digits: int = 2) -> str:
    """Returns a number with that many decimals, a dash for none."""
    return DASH if value is None else f"{value:.{digits}f}".replace("-", "−")


def percent(share: float | None, digits: int = 1) -> str:
    """Returns a share in per cent, a dash for none."""
    return DASH if share is None else f"{100 * share:.{digits}f} %"
