"""The simulation process (`python -m workers.sim.simulate`): takes orders on stdin, reports on what was its stdout.

Holds no lease and talks to no network; it ends with its supervisor, whatever it is doing.

Design: docs/design/protocol.md#threads-and-processes.
"""

from __future__ import annotations

import os

# read when numpy and Mesa are imported: one process, one core
os.environ.setdefault("LP_NUM_THREADS", "0")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import errno
import faulthandler
import hashlib
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from schemas.errors import FactoryError
from schemas.terms import FailReason
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind, failure, to_line
from workers.process.pipes import listen, take_stdout
from workers.sim.attempt import AttemptFailure, run_attempt
from workers.sim.scene_renderer import SceneRenderer

__all__ = ["main"]

_PROGRESS_S = 0.25
_DISK_FULL = {errno.ENOSPC, errno.EDQUOT}
_OK, _WORLD, _BUG = 0, 1, 3

SendReport = Callable[[SimulationReport], None]


def main() -> int:
    """Serves orders until stdin closes; returns 3 when an attempt broke so that the process cannot be trusted."""
    parser = argparse.ArgumentParser(prog="workers.sim.simulate", description="Simulates attempts for a supervisor.")
    parser.add_argument("--renderer", choices=("auto", "gl", "tiny"), default="auto")
    arguments = parser.parse_args()
    faulthandler.enable()
    out = take_stdout()
    orders = listen(0)

    def tell(report: SimulationReport) -> None:
        out.write(to_line(report))

    try:
        with SceneRenderer(arguments.renderer) as stage:
            tell(SimulationReport(kind=SimulationReportKind.READY, renderer=stage.renderer.description))
            while _serve(SimulationOrder.model_validate_json(orders.get()), stage, tell):
                pass
    except BrokenPipeError:
        return _OK  # nobody listens any more
    except FactoryError as error:
        print(error, file=sys.stderr)  # noqa: T201 - the supervisor reads the last line
        return _WORLD
    return _BUG


def _serve(order: SimulationOrder, stage: SceneRenderer, tell: SendReport) -> bool:
    """Does one order; returns whether the process is still sound."""
    pace = _Pace(tell)
    part = Path(f"{order.bundle_path}.part")
    sound = True
    try:
        report = _attempt(order, stage, part, pace)
    except FactoryError as error:
        report = failure(FailReason.CRASH, str(error), pace.step, pace.seconds())
    except OSError as error:
        # a full disk is no fault of the job
        reason = FailReason.RELEASED if error.errno in _DISK_FULL else FailReason.CRASH
        report = failure(reason, _last_line(error), pace.step, pace.seconds())
    except Exception as error:  # noqa: BLE001 - the worker loop: told, and the process given up
        traceback.print_exc()
        report, sound = failure(FailReason.CRASH, _last_line(error), pace.step, pace.seconds()), False
    part.unlink(missing_ok=True)
    tell(report)
    return sound


def _attempt(order: SimulationOrder, stage: SceneRenderer, part: Path, pace: _Pace) -> SimulationReport:
    stage.load(order.scene_path, order.job.scene_sha256)
    with part.open("w+b") as file:
        outcome = run_attempt(order.job, stage, file, order.sid, pace)
        if isinstance(outcome, AttemptFailure):
            return failure(outcome.reason, outcome.detail, outcome.steps, pace.seconds())
        file.flush()
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        os.fsync(file.fileno())
    part.rename(order.bundle_path)
    return SimulationReport(
        kind=SimulationReportKind.SUCCESS, step=pace.step, sha256=digest, size=size, seconds=pace.seconds()
    )


class _Pace:
    """Passes steps on a few times a second: often enough to be seen alive, too seldom to cost."""

    def __init__(self, tell: SendReport) -> None:
        self.step = 0
        self._tell = tell
        self._begun = self._told = time.monotonic()

    def __call__(self, step: int) -> None:
        self.step = step
        now = time.monotonic()
        if now - self._told >= _PROGRESS_S:
            self._told = now
            self._tell(SimulationReport(kind=SimulationReportKind.PROGRESS, step=step))

    def seconds(self) -> float:
        """Wall time since the order."""
        return time.monotonic() - self._begun


def _last_line(error: BaseException) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1:]
    place = "".join(f" ({Path(frame.filename).name}:{frame.lineno})" for frame in where)
    return traceback.format_exception_only(error)[-1].strip() + place


if __name__ == "__main__":
    status = main()
    sys.stderr.flush()
    os._exit(status)  # the thread that waits for orders would keep the interpreter from ending
