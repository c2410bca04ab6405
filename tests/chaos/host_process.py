"""Runs a module on a host of `tests.chaos.hosts`. Arguments: `NAMESPACE MODULE ARGUMENT...`."""

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from typing import NoReturn

from schemas.support.child import python_module

_CLONE_NEWNET = 0x40000000


def on_host(namespace: str, module: str, *words: object) -> tuple[str, ...]:
    """Returns the command line that runs `main` of a module in a network namespace."""
    return python_module("tests.chaos.host_process", namespace, module, *map(str, words))


def main() -> NoReturn:
    """Enters the namespace and then runs the module, so all threads of the module are in the namespace."""
    namespace, module, *words = sys.argv[1:]
    with open(f"/run/netns/{namespace}") as opened:
        if ctypes.CDLL(None, use_errno=True).setns(opened.fileno(), _CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), namespace)
    sys.argv = [module, *words]
    sys.exit(importlib.import_module(module).main())


if __name__ == "__main__":
    main()
