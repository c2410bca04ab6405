"""Driver process (`python -m factory.eval.process.child`): runs simulation and policy; orders on stdin, reports on
stdout.

The process exits when its parent exits. A policy that hangs or crashes affects this process only. Writes no results.

Design: docs/design/evaluation.md#policy-and-simulation-share-a-process.
"""

from __future__ import annotations

import os

# numpy and Mesa read these variables when they are imported; each process uses one core
os.environ.setdefault("LP_NUM_THREADS", "0")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import contextlib
import faulthandler
import queue
import sys
import traceback
from collections.abc import Callable

from factory.dataset.packages import light_file
from factory.eval.driving.policy import Policy, PrivilegedPolicy, ServerUnreachable, training_of
from factory.eval.driving.rollout import describe_error, run_episode
from factory.eval.driving.simulator import Simulator
from factory.eval.models.messages import DriverOrder, EvalReport, EvalReportKind, EvalSetup, to_line
from factory.eval.models.result import EpisodeResult, EvalEnd
from factory.eval.policies.made_from import hashes_of
from factory.eval.policies.registry import describe_knowledge, file_of, make_policy, require_inputs
from factory.eval.policies.remote import close_connections
from factory.eval.process.shared_status import Activity, SharedStatus, StatusWriter
from schemas.errors import FactoryError, UsageError
from workers.process.pipes import listen, take_stdout
from workers.sim.context import SimulationContext

SendReport = Callable[[EvalReport], None]


def main() -> int:
    """Serves orders until stdin closes."""
    parser = argparse.ArgumentParser(prog="factory.eval.process.child", description="Runs policies for an evaluation.")
    parser.add_argument("status", type=int, help="File descriptor of the shared status.")
    parser.add_argument("--render-apart", action="store_true", help="Render in a separate process.")
    arguments = parser.parse_args()
    faulthandler.enable()
    shared = SharedStatus(arguments.status)
    out = take_stdout()
    lines = listen(0, close_connections)

    def tell(report: EvalReport) -> None:
        out.write(to_line(report))

    try:
        order = DriverOrder.model_validate_json(lines.get())
        setup = order.task.setup
        with (
            SimulationContext(setup.renderer, apart=arguments.render_apart) as stage,
            Simulator(stage, setup.settings, setup.view.appearance) as simulator,
        ):
            driver = _Driver(setup, stage, simulator, shared, tell)
            tell(EvalReport(kind=EvalReportKind.READY, detail=stage.renderer.description))
            while driver.serve(order):
                order = DriverOrder.model_validate_json(driver.wait(lines))
    except BrokenPipeError:
        return 0  # the parent has exited
    except FactoryError as error:
        tell(EvalReport(kind=EvalReportKind.REFUSED, detail=str(error), exit_code=_exit_code(error)))
        return 1
    return 3


def _exit_code(error: FactoryError) -> int:
    return 2 if isinstance(error, UsageError) else 1


class _Driver:
    """Executes orders with the current policy, and updates the shared status."""

    def __init__(
        self, setup: EvalSetup, stage: SimulationContext, simulator: Simulator, shared: SharedStatus, tell: SendReport
    ) -> None:
        self._setup, self._stage, self._simulator, self._tell = setup, stage, simulator, tell
        self._status = StatusWriter(shared)
        self._reference = ""
        self._policy: Policy | None = None

    def wait(self, lines: queue.Queue[bytes]) -> bytes:
        self._status.note(Activity.IDLE)
        return lines.get()

    def serve(self, order: DriverOrder) -> bool:
        """Executes one order; returns whether the process can continue."""
        number = order.task.number
        try:
            result = self._drive(order)
        except ServerUnreachable as error:
            self._tell(EvalReport(kind=EvalReportKind.AWAY, number=number, detail=str(error)))
        except FactoryError as error:
            code = _exit_code(error)
            self._tell(EvalReport(kind=EvalReportKind.REFUSED, number=number, detail=str(error), exit_code=code))
        except Exception as error:  # noqa: BLE001 - worker loop: the error is reported and the process exits
            traceback.print_exc()
            self._tell(EvalReport(kind=EvalReportKind.DEFECT, number=number, detail=describe_error(error)))
            return False
        else:
            self._tell(EvalReport(kind=EvalReportKind.RESULT, number=number, result=result))
        return True

    def _drive(self, order: DriverOrder) -> EpisodeResult:
        policy = self._policy_of(order)
        self._status.begin(Activity.SIMULATING)
        sha256, appearance = order.task.request.spec.scene_sha256, self._setup.view.appearance
        light = None if appearance is None or appearance.light is None else light_file(order.package, sha256)
        loaded = self._stage.load(order.package, sha256, light)
        result = run_episode(order.task, policy, self._simulator, loaded, self._status)
        if result.end is EvalEnd.POLICY_LOST:
            # the server may have restarted: repeat the episode once, so the result does not describe the network
            self._status.is_warm = False
            self._status.begin(Activity.SIMULATING)
            result = run_episode(order.task, policy, self._simulator, loaded, self._status)
        if result.end in {EvalEnd.POLICY_LOST, EvalEnd.POLICY_HUNG}:
            self._status.is_warm = False  # the first reply over a new connection has the longer time limit
        return result

    def _policy_of(self, order: DriverOrder) -> Policy:
        reference = order.task.reference
        if self._policy is None or reference != self._reference:
            self._status.begin(Activity.MAKING)
            close = getattr(self._policy, "close", None)
            if callable(close):
                with contextlib.suppress(Exception):
                    close()
            self._policy, self._reference = None, reference
            policy = make_policy(reference, self._setup, order.policy_file)
            file = order.policy_file or file_of(reference)
            require_inputs(reference, policy, self._setup.view.rig, self._setup.settings.camera)
            self._policy = policy
            self._status.is_warm = False
            self._status.is_privileged = isinstance(self._policy, PrivilegedPolicy)
            knows, hashes = describe_knowledge(policy), hashes_of(reference, policy, file)
            self._tell(
                EvalReport(
                    kind=EvalReportKind.POLICY,
                    number=order.task.number,
                    detail=knows,
                    made_from=hashes,
                    training=training_of(policy),
                )
            )
        return self._policy


if __name__ == "__main__":
    status = main()
    sys.stderr.flush()
    os._exit(status)  # the thread that waits for orders would block the interpreter's exit
