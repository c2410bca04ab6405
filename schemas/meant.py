"""What somebody may have meant who wrote a name that is none. Pure; the message around it is the caller's."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = ["did_you_mean"]


def did_you_mean(word: str, names: Iterable[str]) -> str:
    """Returns `; did you mean 'NAME'?` with the nearest name, or nothing where none is near.

    >>> did_you_mean("offfice", ["hospital", "office"])
    "; did you mean 'office'?"
    >>> did_you_mean("oracle", ["hospital", "office"])
    ''
    """
    spelt = {name.lower(): str(name) for name in names}
    near = difflib.get_close_matches(word.lower(), spelt, n=1)
    return f"; did you mean {spelt[near[0]]!r}?" if near else ""
