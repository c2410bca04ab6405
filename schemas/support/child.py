"""How our own Python processes are started, so that they import no file of the working directory. Starts none itself.

`python -m` puts the working directory first on the import path; a dataset, or a user's folder, may hold a module with
the name of one of ours.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

__all__ = ["SAFE_PATH", "child_environment", "import_path", "python_module"]

SAFE_PATH = "PYTHONSAFEPATH"
"""The variable that does what `-P` does."""
_HOME = str(Path(__file__).resolve().parents[2])
"""The directory that holds our packages."""
_INTERACTIVE = frozenset({"PYTHONSTARTUP", "PYTHONINSPECT", "PYTHONBREAKPOINT"})
"""Variables that are meant for an interactive session; the second keeps a process alive after its end."""
_PATH = "PYTHONPATH"
_HERE = frozenset({"", os.curdir})
"""Entries of `PYTHONPATH` that mean the working directory; the first comes from `PYTHONPATH=$PYTHONPATH:/more`."""


def python_module(name: str, *arguments: str) -> tuple[str, ...]:
    """Returns the command line that runs a module of ours with this interpreter, outside the working directory."""
    return (sys.executable, "-P", "-m", name, *arguments)


def child_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns the environment of a child process: the given one, without what would change which code it runs.

    What brings packages stays: a virtual environment, `PYTHONHOME`, and the directories of `PYTHONPATH` other than the
    working directory. The directory of our packages is added where only the working directory would have brought it.
    """
    kept = {name: value for name, value in environment.items() if name not in _INTERACTIVE}
    given = kept.pop(_PATH, "")
    path = [entry for entry in given.split(os.pathsep) if entry not in _HERE]
    if os.getcwd() == _HOME and _HOME not in path:  # noqa: PTH109 - compared as text, as Python's own path is
        path.append(_HOME)
    return kept | ({_PATH: os.pathsep.join(path)} if path else {})


def import_path(path: Sequence[str]) -> str:
    """Returns a `PYTHONPATH` with the entries of this process's `sys.path`, without the working directory.

    For a child whose environment is otherwise empty.
    """
    here = os.getcwd()  # noqa: PTH109
    return os.pathsep.join(entry for entry in path if entry not in _HERE and (entry != here or entry == _HOME))
