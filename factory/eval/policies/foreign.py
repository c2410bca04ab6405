"""A policy of the user's own: a class in an importable module, made without arguments. Imports, never judges."""

from __future__ import annotations

import importlib
import os
import sys
import traceback
from pathlib import Path

from factory.eval.policy import Policy
from schemas.errors import UsageError

__all__ = ["load_class"]


def load_class(name: str) -> Policy:
    """Returns an instance of `package.module:Class`; modules of the working directory are found too.

    Raises:
        UsageError: there is no such module or class, or making it failed; the message says where.
    """
    module_name, _, class_name = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        found = importlib.import_module(module_name)
        for part in class_name.split("."):
            found = getattr(found, part)
        policy: Policy = found()  # type: ignore[operator]
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{os.path.relpath(last.filename)}:{last.lineno}"
        what = traceback.format_exception_only(error)[-1].strip()
        raise UsageError(f"policy {name} cannot be made: {what} ({where})") from error
    return policy
