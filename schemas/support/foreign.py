"""What parsers of other people may raise over a file from outside, and which paths no file system takes. Pure."""

from __future__ import annotations

import tokenize

__all__ = ["PARSER_ERRORS", "path_trouble"]

PARSER_ERRORS: tuple[type[Exception], ...] = (
    ValueError,  # UnicodeError, a NUL in a path, most of pyarrow
    TypeError,
    LookupError,
    ArithmeticError,
    OSError,
    EOFError,
    SyntaxError,
    MemoryError,
    RuntimeError,  # RecursionError, NotImplementedError
    tokenize.TokenError,
)
"""A parser's own way to say that a file is none; a door turns them into our errors, naming the file."""
_LONGEST_NAME, _LONGEST_PATH = 255, 4095


def path_trouble(path: str) -> str:
    """Returns why no file system of ours can have a path, in words; empty when it can."""
    if "\0" in path:
        return "it contains a NUL character"
    try:
        encoded = path.encode("utf-8", "surrogateescape")
    except UnicodeError:
        return "it cannot be encoded as UTF-8"
    longest = max(map(len, encoded.split(b"/")))
    if longest > _LONGEST_NAME:
        return f"a name in it has {longest} bytes; at most {_LONGEST_NAME} are possible"
    if len(encoded) > _LONGEST_PATH:
        return f"it has {len(encoded)} bytes; at most {_LONGEST_PATH} are possible"
    return ""
