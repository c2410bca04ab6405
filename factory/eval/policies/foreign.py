"""A policy of the user's own: a class in an importable module, made without arguments. Imports, never judges."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import inspect
import os
import sys
import traceback
from collections.abc import Iterator
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType

from factory.eval.driving.policy import Policy
from schemas.errors import UsageError
from schemas.support.suggest import did_you_mean

__all__ = ["load_class", "require_module"]

_IMPORTER = importlib.__file__
_EXAMPLE = "docs/evaluation/my_policy.py is an example"


def load_class(name: str) -> Policy:
    """Returns an instance of `package.module:Class`, which may be a module of the working directory.

    While it is imported and made the working directory comes first, as in a script of its own; afterwards last, so that
    what a policy imports later is found, and what we import later is ours.

    Raises:
        UsageError: there is no such module or class, or making it failed; the message says where.
    """
    module_name, _, class_name = name.partition(":")
    try:
        with _working_directory_first():
            module = importlib.import_module(module_name)
            found = _class_of(module, class_name, name)
            policy: Policy = found()  # type: ignore[operator]
    except UsageError:
        raise
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and _is_part(error.name, module_name):
            raise UsageError(_say_absent(name, error.name or module_name)) from error
        raise UsageError(f"policy {name} cannot be created: {_say_with_place(error)}") from error
    return policy


@contextlib.contextmanager
def _working_directory_first() -> Iterator[None]:
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):  # the module may have taken it away itself
            sys.path.remove(here)
        if here not in sys.path:
            sys.path.append(here)


def require_module(name: str) -> None:
    """Makes sure that the module of `package.module:Class`, or the package it is in, can be found; imports nothing.

    Raises:
        UsageError: it cannot; the message says where it was looked for.
    """
    top = name.partition(":")[0].partition(".")[0]
    if top in sys.modules or importlib.util.find_spec(top) or PathFinder.find_spec(top, [str(Path.cwd())]):
        return
    raise UsageError(_say_absent(name, top))


def _class_of(module: ModuleType, class_name: str, name: str) -> object:
    found: object = module
    for part in class_name.split("."):
        if not hasattr(found, part):
            own = [key for key, value in vars(module).items() if _is_public_class(key, value, module)]
            there = f"{module.__file__ or module.__name__} has {', '.join(own) or 'no public class'}"
            raise UsageError(f"policy {name}: no class {class_name!r}; {there}{did_you_mean(class_name, own)}")
        found = getattr(found, part)
    return found


def _is_public_class(key: str, value: object, module: ModuleType) -> bool:
    return inspect.isclass(value) and not key.startswith("_") and value.__module__ == module.__name__


def _is_part(absent: str | None, module_name: str) -> bool:
    """Whether what could not be imported is the module asked for or a package around it, not something it needs."""
    return absent is not None and f"{module_name}.".startswith(f"{absent}.")


def _say_absent(name: str, absent: str) -> str:
    looked = f"looked in {Path.cwd()}, on PYTHONPATH and among the packages of {sys.prefix}"
    remedy = "run the command in the folder of the module, or add that folder to PYTHONPATH"
    return f"policy {name}: no module {absent!r}; {looked}: {remedy} ({_EXAMPLE})"


def _say_with_place(error: Exception) -> str:
    """Returns an exception with the line it came from; those of Python's own importer say nothing to a user."""
    what = traceback.format_exception_only(error)[-1].strip()
    if isinstance(error, SyntaxError) and error.filename:
        return f"{what} ({os.path.relpath(error.filename)}:{error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    mine = [frame for frame in frames if not frame.filename.startswith("<frozen") and frame.filename != _IMPORTER]
    return f"{what} ({os.path.relpath(mine[-1].filename)}:{mine[-1].lineno})"
