"""Entry point of the simulation process (`python -m workers.sim.simulate`): reads orders from stdin, reports to stdout.

The process exits when its supervisor exits. It uses no lease and no network.

Design: docs/design/protocol.md#threads-and-processes.
"""

from __future__ import annotations

import os

# numpy and Mesa read these variables when they are loaded; each process uses one core
os.environ.setdefault("LP_NUM_THREADS", "0")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import base64
import errno
import faulthandler
import hashlib
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from schemas.errors import FactoryError
from schemas.terms import FailReason, RendererKind
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind, failure, to_line
from workers.process.pipes import listen, take_stdout
from workers.sim.attempt import AttemptFailure, run_attempt
from workers.sim.context import SimulationContext
from workers.sim.correct import PolicyDriver, PolicyUnavailable
from workers.sim.render_recording import render_recording

_PROGRESS_S = 0.25
_KEPT_SCENES = 1
"""Number of scenes kept in memory. One is enough, because a worker gets the jobs of a scene one after the other."""
_DISK_FULL = {errno.ENOSPC, errno.EDQUOT}
_OK, _WORLD, _BUG = 0, 1, 3

SendReport = Callable[[SimulationReport], None]


def main() -> int:
    """Serves orders until stdin closes; returns 3 after an unexpected exception, because its state may be invalid."""
    parser = argparse.ArgumentParser(prog="workers.sim.simulate", description="Simulates attempts for a supervisor.")
    parser.add_argument("--renderer", choices=("auto", "gl", "tiny"), default="auto")
    return serve(parser.parse_args().renderer, lambda _send: None)


def serve(
    renderer: RendererKind, open_driver: Callable[[SendReport], PolicyDriver | None], *, apart: bool = False
) -> int:
    """Serves orders until stdin closes, and returns the exit status.

    Args:
        renderer: renderer of the process.
        open_driver: returns the policy of episodes with corrections; gets the function that sends reports.
        apart: whether the renderer runs in a separate process.
    """
    faulthandler.enable()
    out = take_stdout()
    orders = listen(0)

    def send(report: SimulationReport) -> None:
        out.write(to_line(report))

    try:
        driver = open_driver(send)
        with SimulationContext(renderer, apart=apart, kept_scenes=_KEPT_SCENES, driver=driver) as context:
            send(SimulationReport(kind=SimulationReportKind.READY, renderer=context.renderer.description))
            while _serve(SimulationOrder.model_validate_json(orders.get()), context, send):
                pass
    except BrokenPipeError:
        return _OK  # the supervisor has exited
    except FactoryError as error:
        print(error, file=sys.stderr)  # noqa: T201 - the supervisor reads the last line
        return _WORLD
    return _BUG


def _serve(order: SimulationOrder, context: SimulationContext, send: SendReport) -> bool:
    """Executes one order; returns whether the process can serve another one."""
    progress = _Progress(send)
    part = Path(f"{order.bundle_path}.part")
    is_valid = True
    try:
        report = _attempt(order, context, part, progress)
    except PolicyUnavailable as error:
        report, is_valid = failure(FailReason.RELEASED, str(error), progress.step, progress.seconds()), False
    except FactoryError as error:
        report = failure(FailReason.CRASH, str(error), progress.step, progress.seconds())
    except OSError as error:
        # a full disk is not a failure of the job
        reason = FailReason.RELEASED if error.errno in _DISK_FULL else FailReason.CRASH
        report = failure(reason, _last_line(error), progress.step, progress.seconds())
    except Exception as error:  # noqa: BLE001 - the worker loop: reported, and the process exits
        traceback.print_exc()
        report, is_valid = failure(FailReason.CRASH, _last_line(error), progress.step, progress.seconds()), False
    part.unlink(missing_ok=True)
    send(report)
    return is_valid


def _attempt(order: SimulationOrder, context: SimulationContext, part: Path, progress: _Progress) -> SimulationReport:
    context.load(order.scene_path, order.job.scene_sha256, order.light_path)
    with part.open("w+b") as file:
        if order.states is None:
            outcome = run_attempt(order.job, context, out=file, sid=order.sid, on_step=progress)
        else:
            outcome = render_recording(
                order.job, context, states=base64.b64decode(order.states), out=file, on_step=progress
            )
        if isinstance(outcome, AttemptFailure):
            return failure(outcome.reason, outcome.detail, outcome.steps, progress.seconds())
        file.flush()
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        os.fsync(file.fileno())
    part.rename(order.bundle_path)
    return SimulationReport(
        kind=SimulationReportKind.SUCCESS, step=progress.step, sha256=digest, size=size, seconds=progress.seconds()
    )


class _Progress:
    """Step callback that reports progress at most four times per second."""

    def __init__(self, send: SendReport) -> None:
        self.step = 0
        self._send = send
        self._started = self._reported = time.monotonic()

    def __call__(self, step: int) -> None:
        self.step = step
        now = time.monotonic()
        if now - self._reported >= _PROGRESS_S:
            self._reported = now
            self._send(SimulationReport(kind=SimulationReportKind.PROGRESS, step=step))

    def seconds(self) -> float:
        """Returns the wall time since the order, seconds."""
        return time.monotonic() - self._started


def _last_line(error: BaseException) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1:]
    place = "".join(f" ({Path(frame.filename).name}:{frame.lineno})" for frame in where)
    return traceback.format_exception_only(error)[-1].strip() + place


if __name__ == "__main__":
    status = main()
    sys.stderr.flush()
    os._exit(status)  # a normal exit would wait for the thread that reads orders
