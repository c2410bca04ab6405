"""Exceptions that third-party parsers raise for invalid files, and validation of paths. Reads no file."""

from __future__ import annotations

import tokenize

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
"""Exceptions of a third-party parser for an invalid file; the caller converts them to an error that names the file."""
_LONGEST_NAME, _LONGEST_PATH = 255, 4095


def path_trouble(path: str) -> str:
    """Returns the reason why a path is not valid, or an empty text for a valid path."""
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
