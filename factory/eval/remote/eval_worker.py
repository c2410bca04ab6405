"""Evaluation worker (`python -m factory.eval.remote.eval_worker`), which a worker starts instead of a simulation.

Receives orders from the worker, evaluates them in a driver process, and writes results as bundles.
Runs no simulation itself; exits with its worker.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
import time
from pathlib import Path
from typing import BinaryIO, cast

from factory.eval.models.messages import DriverOrder, EvalReportKind, EvalTask
from factory.eval.models.messages import EvalReport as Outcome
from factory.eval.models.result import EpisodeResult
from factory.eval.policies.registry import is_user_class, note_of
from factory.eval.process.driver_process import DriverEnded, DriverProcess, interrupted_result
from factory.eval.remote.results import ResultBundle, write_result_bundle
from schemas.terms import FailReason, RendererKind
from workers.process import messages as worker
from workers.process.messages import SimulationOrder, failure
from workers.process.pipes import listen, take_stdout

_POLL_S, _TELL_S = 0.1, 1.0
_NO_IMPORTS = "this worker imports no policy classes; if its coordinator is trusted, start it with --import-policies"


def main() -> int:
    """Serves orders until stdin closes."""
    parser = argparse.ArgumentParser(
        prog="factory.eval.remote.eval_worker", description="Evaluates policies for a worker."
    )
    parser.add_argument("--renderer", choices=("auto", "gl", "tiny"), default="auto")
    parser.add_argument("--import-policies", action="store_true")
    arguments = parser.parse_args()
    renderer = cast(RendererKind, arguments.renderer)
    out, lines = take_stdout(), listen(0)
    worker_process = _EvalWorker(renderer, arguments.import_policies, out)
    try:
        worker_process.tell(
            worker.SimulationReport(
                kind=worker.SimulationReportKind.READY, renderer=f"{renderer}, opened with the first episode"
            )
        )
        while True:
            worker_process.serve(SimulationOrder.model_validate_json(lines.get()))
    except BrokenPipeError:
        return 0  # the worker has exited


class _EvalWorker:
    """Executes the orders of the worker with one driver process."""

    def __init__(self, renderer: RendererKind, may_import: bool, out: BinaryIO) -> None:
        self._renderer, self._may_import, self._out = renderer, may_import, out
        self._driver = DriverProcess()

    def tell(self, report: worker.SimulationReport) -> None:
        self._out.write(worker.to_line(report))

    def serve(self, order: SimulationOrder) -> None:
        started, driver = time.monotonic(), self._driver
        task = EvalTask.model_validate_json(order.eval_task or "")
        if is_user_class(task.reference) and not self._may_import:
            # the name came over the network, and importing it would execute arbitrary code
            self.tell(failure(FailReason.CRASH, f"policy {task.reference}: {_NO_IMPORTS}"))
            return
        setup = task.setup.model_copy(update={"renderer": self._renderer})
        task = task.model_copy(update={"setup": setup})
        driver.send(DriverOrder(task=task, package=order.scene_path, policy_file=order.attachment_path))
        outcome = self._wait()
        driver.current = None
        result = _result(outcome, task, driver)
        if isinstance(result, worker.SimulationReport):
            self.tell(result)
        else:
            note = note_of(task, driver.made[task.policy], driver.renderer)
            self.tell(_seal(ResultBundle(result=result, note=note), order.bundle_path, time.monotonic() - started))

    def _wait(self) -> Outcome | DriverEnded:
        """Returns the outcome of the current task; meanwhile, sends progress reports to the worker."""
        last_report_s, driver = time.monotonic(), self._driver
        while True:
            outcome = driver.poll(_POLL_S)
            if outcome is not None:
                return outcome
            if time.monotonic() - last_report_s > _TELL_S:
                last_report_s = time.monotonic()
                kind = worker.SimulationReportKind.PROGRESS
                self.tell(worker.SimulationReport(kind=kind, step=driver.steps, waits=driver.long_wait))


def _result(
    outcome: Outcome | DriverEnded, task: EvalTask, driver: DriverProcess
) -> EpisodeResult | worker.SimulationReport:
    """Returns the result of a task, or a failure report.

    The reason in the report is `RELEASED` if this machine or the server of the policy caused the failure.
    """
    if isinstance(outcome, DriverEnded):
        if outcome.fault is not None and task.policy in driver.made:
            return interrupted_result(task, outcome.detail, outcome.fault, outcome.state)
        where = "" if outcome.fault is None else f"policy {task.policy} cannot be created: "
        return failure(FailReason.CRASH, where + outcome.detail, outcome.state.steps)
    if outcome.result is not None:
        return outcome.result
    is_of_this_machine = outcome.kind is EvalReportKind.AWAY or outcome.number != task.number
    return failure(FailReason.RELEASED if is_of_this_machine else FailReason.CRASH, outcome.detail)


def _seal(driven: ResultBundle, path: Path, seconds: float) -> worker.SimulationReport:
    """Writes a bundle atomically."""
    part = Path(f"{path}.part")
    try:
        with part.open("w+b") as file:
            write_result_bundle(driven, file)
            size = file.seek(0, os.SEEK_END)
            file.seek(0)
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            os.fsync(file.fileno())
        part.rename(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        return failure(FailReason.RELEASED, f"cannot write {part.name}: {error.strerror}", seconds=seconds)
    step = driven.result.num_steps
    return worker.SimulationReport(
        kind=worker.SimulationReportKind.SUCCESS, step=step, sha256=sha256, size=size, seconds=seconds
    )


if __name__ == "__main__":
    sys.exit(main())
