"""Suggests the closest known name for a misspelled one. The caller formats the message around it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(word: str, names: Iterable[str], most: int = 1) -> str:
    """Returns `; did you mean 'NAME'?` with the closest names, or an empty text if no name is close.

    Args:
        word: the misspelled name.
        names: the known names.
        most: largest number of names to return.

    >>> did_you_mean("offfice", ["hospital", "office"])
    "; did you mean 'office'?"
    >>> did_you_mean("stauts", ["stats", "status", "run"], most=2)
    "; did you mean 'stats' or 'status'?"
    >>> did_you_mean("oracle", ["hospital", "office"])
    ''
    """
    by_lower = {name.lower(): str(name) for name in names}
    near = difflib.get_close_matches(word.lower(), by_lower, n=most)
    return f"; did you mean {' or '.join(repr(by_lower[name]) for name in near)}?" if near else ""
