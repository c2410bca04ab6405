"""Runs the text of a script in a new process as `python -c` does, but forked, see `tests.builders.fork_helper`."""

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
