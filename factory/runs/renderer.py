"""Checks once, before a run, that simulations of this machine can start with a renderer. Loads no driver itself."""

from __future__ import annotations

import os

from schemas.errors import WorldError
from schemas.support.child import child_environment, python_module
from schemas.support.jsonl_process import JsonlProcess, describe_exit
from schemas.terms import RendererKind
from workers.process.messages import read_report

_START_S = 60.0
_REMEDY = (
    "on Debian: apt-get install libegl1 libgl1-mesa-dri; or leave --renderer out, which falls back to the slower "
    "TinyRenderer"
)


def require_renderer(renderer: RendererKind) -> None:
    """Starts and ends a simulation if a renderer is required that this machine may not have.

    The renderer `auto` is not checked, because it falls back to TinyRenderer.

    Raises:
        WorldError: the simulation does not start, e.g. because no EGL driver is installed.
    """
    if renderer != "gl":
        return
    command = python_module("workers.sim.simulate", "--renderer", renderer)
    process = JsonlProcess(command, child_environment(os.environ), read_report)
    try:
        if process.read(_START_S) is None:
            raise WorldError(f"--renderer {renderer}: the simulation did not start within {_START_S:g} s")
    except EOFError as error:
        cause = process.last_stderr_line() or describe_exit(process.wait())
        raise WorldError(f"--renderer {renderer}: {cause}; {_REMEDY}") from error
    finally:
        process.kill()
