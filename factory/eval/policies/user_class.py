"""Loads a user's policy: a class in an importable module, constructed without arguments. Does not run the policy."""

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

_IMPORTER = importlib.__file__
_EXAMPLE = "docs/evaluation/my_policy.py is an example"


def load_class(name: str) -> Policy:
    """Returns an instance of `package.module:Class`; the module may be in the working directory.

    During import and construction, the working directory is first in `sys.path`, as for a script; afterwards it is
    last, so later imports of the policy find their modules, and this software does not import from it by mistake.

    Raises:
        UsageError: The module or class does not exist, or the construction failed; the message contains the location.
    """
    module_name, _, class_name = name.partition(":")
    try:
        with _working_directory_first():
            module = importlib.import_module(module_name)
            loaded = _class_of(module, class_name, name)
            policy: Policy = loaded()  # type: ignore[operator]
    except UsageError:
        raise
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and _is_part(error.name, module_name):
            raise UsageError(_describe_missing(name, error.name or module_name)) from error
        raise UsageError(f"policy {name} cannot be created: {_describe_with_location(error)}") from error
    return policy


@contextlib.contextmanager
def _working_directory_first() -> Iterator[None]:
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):  # the module may have removed the folder from the path
            sys.path.remove(here)
        if here not in sys.path:
            sys.path.append(here)


def require_module(name: str) -> None:
    """Raises an error unless the top-level package of `package.module:Class` is found; imports nothing.

    Raises:
        UsageError: The module was not found; the message lists the searched locations.
    """
    top = name.partition(":")[0].partition(".")[0]
    if top in sys.modules or importlib.util.find_spec(top) or PathFinder.find_spec(top, [str(Path.cwd())]):
        return
    raise UsageError(_describe_missing(name, top))


def source_folder(name: str) -> Path | None:
    """Returns the folder that contains the package or module of `package.module:Class`; imports nothing."""
    top = name.partition(":")[0].partition(".")[0]
    spec = PathFinder.find_spec(top, [str(Path.cwd())]) or importlib.util.find_spec(top)
    if spec is None:
        return None
    if spec.submodule_search_locations:
        return Path(next(iter(spec.submodule_search_locations))).resolve().parent
    return None if spec.origin is None else Path(spec.origin).resolve().parent


def _class_of(module: ModuleType, class_name: str, name: str) -> object:
    attribute: object = module
    for part in class_name.split("."):
        if not hasattr(attribute, part):
            candidates = [key for key, value in vars(module).items() if _is_public_class(key, value, module)]
            there = f"{module.__file__ or module.__name__} has {', '.join(candidates) or 'no public class'}"
            raise UsageError(f"policy {name}: no class {class_name!r}; {there}{did_you_mean(class_name, candidates)}")
        attribute = getattr(attribute, part)
    return attribute


def _is_public_class(key: str, value: object, module: ModuleType) -> bool:
    return inspect.isclass(value) and not key.startswith("_") and value.__module__ == module.__name__


def _is_part(absent: str | None, module_name: str) -> bool:
    """Returns whether the missing module is the requested one or a parent package, not one of its dependencies."""
    return absent is not None and f"{module_name}.".startswith(f"{absent}.")


def _describe_missing(name: str, absent: str) -> str:
    looked = f"looked in {Path.cwd()}, on PYTHONPATH and among the packages of {sys.prefix}"
    remedy = "run the command in the folder of the module, or add that folder to PYTHONPATH"
    return f"policy {name}: no module {absent!r}; {looked}: {remedy} ({_EXAMPLE})"


def _describe_with_location(error: Exception) -> str:
    """Returns an exception with its source line; skips frames of Python's importer, which do not help a user."""
    what = traceback.format_exception_only(error)[-1].strip()
    if isinstance(error, SyntaxError) and error.filename:
        return f"{what} ({os.path.relpath(error.filename)}:{error.lineno})"
    frames = traceback.extract_tb(error.__traceback__)
    mine = [frame for frame in frames if not frame.filename.startswith("<frozen") and frame.filename != _IMPORTER]
    return f"{what} ({os.path.relpath(mine[-1].filename)}:{mine[-1].lineno})"
