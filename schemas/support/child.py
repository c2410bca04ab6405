"""Command line and environment with which the product's child processes import no file of the working directory.

`python -m` puts the working directory first on the import path, and a dataset or a user's folder may contain a module
with the name of a module of the product. This module starts no process.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable with the effect of the option `-P`."""
_HOME = str(Path(__file__).resolve().parents[2])
"""Directory that contains the product's packages."""
_INTERACTIVE = frozenset({"PYTHONSTARTUP", "PYTHONINSPECT", "PYTHONBREAKPOINT"})
"""Variables for interactive sessions; `PYTHONINSPECT` would keep the interpreter running after the
program has ended."""
_PATH = "PYTHONPATH"
_HERE = frozenset({"", os.curdir})
"""Entries of `PYTHONPATH` that mean the working directory; the first comes from `PYTHONPATH=$PYTHONPATH:/more`."""


def python_module(name: str, *arguments: str) -> tuple[str, ...]:
    """Returns the command line that runs a module with this interpreter, without the working directory on its path."""
    return (sys.executable, "-P", "-m", name, *arguments)


def child_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns the environment of a child process without the variables that would change which code it runs.

    The variables that provide packages stay: a virtual environment, `PYTHONHOME`, and the directories of `PYTHONPATH`
    other than the working directory. The directory of the product's packages is added if the parent imports them from
    the working directory.
    """
    kept = {name: value for name, value in environment.items() if name not in _INTERACTIVE}
    given = kept.pop(_PATH, "")
    path = [entry for entry in given.split(os.pathsep) if entry not in _HERE]
    if os.getcwd() == _HOME and _HOME not in path:  # noqa: PTH109 - compared as text, as Python's own path is
        path.append(_HOME)
    return kept | ({_PATH: os.pathsep.join(path)} if path else {})


def import_path(path: Sequence[str]) -> str:
    """Returns a `PYTHONPATH` with the entries of `path`, usually `sys.path`, without the working directory.

    Use it for a child process with an otherwise empty environment.
    """
    here = os.getcwd()  # noqa: PTH109
    return os.pathsep.join(entry for entry in path if entry not in _HERE and (entry != here or entry == _HOME))
