"""Quotes words of the commands that messages print."""

from __future__ import annotations

import shlex


def quoted(word: object) -> str:
    """Returns a path or another word so that a printed command can be pasted into a shell.

    >>> quoted("my data")
    "'my data'"
    """
    return shlex.quote(str(word))
