"""Runs a script given as text, like `python -c`, but as a module that `tests.builders.fork_helper` can fork."""

from __future__ import annotations

import sys

from schemas.support.child import python_module


def script(text: str, *words: object) -> tuple[str, ...]:
    """Returns the command line of a script; `sys.argv` of the script is `["-c", *words]`."""
    return python_module("tests.builders.script", text, *map(str, words))


if __name__ == "__main__":
    code = compile(sys.argv[1], "<script>", "exec")
    sys.argv = ["-c", *sys.argv[2:]]
    exec(code, {"__name__": "__main__"})
