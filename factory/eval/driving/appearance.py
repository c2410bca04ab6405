"""Appearance of closed-loop episodes, which have no recorded path from which clutter could keep its distance."""

from __future__ import annotations

from pathlib import Path

from schemas.appearance import Appearance
from schemas.appearance.file import find_appearance
from schemas.errors import UsageError


def live_appearance(appearance: str | Path | Appearance) -> Appearance | None:
    """Returns the appearance of a closed-loop evaluation: ranges, or those of a name or file; `None` for `none`.

    Raises:
        UsageError: the appearance does not exist, or has clutter.
        InvalidAppearance: the file has mistakes.
    """
    found = appearance if isinstance(appearance, Appearance) else find_appearance(str(appearance))
    if found is not None and found.clutter is not None:
        raise UsageError(
            f"appearance {found.name!r} has clutter, which keeps its distance from a recorded drive and is not solid: "
            "remove `clutter` for an evaluation, or choose `varied`"
        )
    return found
