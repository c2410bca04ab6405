"""Finds the appearance of evaluation episodes. They cannot have clutter: it is placed away from a
recorded path, and an evaluated policy drives another path."""

from __future__ import annotations

from pathlib import Path

from schemas.appearance import Appearance
from schemas.appearance.file import find_appearance
from schemas.errors import UsageError


def live_appearance(appearance: str | Path | Appearance) -> Appearance | None:
    """Returns the appearance of an evaluation, given as ranges, name or file; `None` for the name `none`.

    Raises:
        UsageError: the appearance does not exist, or has clutter.
        InvalidAppearance: the file is not valid.
    """
    found = appearance if isinstance(appearance, Appearance) else find_appearance(str(appearance))
    if found is not None and found.clutter is not None:
        raise UsageError(
            f"appearance {found.name!r} has clutter, which is placed away from a recorded path and has no "
            "collision shape: remove `clutter` for an evaluation, or choose `varied`"
        )
    return found
