"""Runs one episode with one policy, from reset to result. Returns a result for every failure of the policy.

Starts no processes and writes no files.
"""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from factory.eval.driving import measure
from factory.eval.driving.action import read_actions
from factory.eval.driving.lazy_input import LazyInput
from factory.eval.driving.live_view import RigSensors, live_state, shows_recorded_camera
from factory.eval.driving.measure import odometry, yaws_of
from factory.eval.driving.policy import (
    EpisodeInfo,
    Policy,
    PolicyFailure,
    PolicyFault,
    PolicyInput,
    PrivilegedPolicy,
    PrivilegedState,
    ServerUnreachable,
    attention_of,
    kind_of_actions,
    uses_camera,
    was_trained_on,
)
from factory.eval.driving.simulator import Simulator
from factory.eval.models.messages import EvalRequest, EvalTask
from factory.eval.models.result import REAL, Attention, EpisodeResult, EvalEnd
from factory.eval.models.spec import EvalSpec
from schemas.config import TaskConfig
from schemas.frame import Frame
from schemas.measure import Goal
from schemas.rig import Rig
from schemas.support.geometry import footprint_distances
from workers.experts.observation import Observation
from workers.geometry.slew import Twist
from workers.sim.context import LoadedScene

TRACK_HZ = 10
_REST = Twist(0.0, 0.0)
_STEP_SLACK = 1e-6
"""Rounding error of a latency in control periods, of which each started one counts."""


class PolicyCallObserver(Protocol):
    """Observer of policy calls, so a monitor can distinguish a hanging policy from a hanging simulation."""

    def before_call(self, simulator: Simulator, view: Observation) -> None:
        """Called before a call of the policy, with the current view; the first call of an episode is its reset."""

    def after_call(self) -> None:
        """Called after a call of the policy returned or raised."""

    def before_render(self) -> None:
        """Called within a call of the policy, before the images that it reads are rendered."""

    def after_render(self) -> None:
        """Called after the images were rendered."""


def run_episode(
    task: EvalTask, policy: Policy, simulator: Simulator, loaded: LoadedScene, observer: PolicyCallObserver
) -> EpisodeResult:
    """Runs an episode to its end and computes its metrics.

    Args:
        task: Episode, instruction and policy name.
        policy: Policy to run; a `PrivilegedPolicy` receives the privileged state.
        simulator: Open simulator with the settings of the spec set.
        loaded: Scene of the spec.
        observer: Observer of the policy calls.

    Raises:
        WorldError: The spec does not match its scene.
        ServerUnreachable: The server of the policy cannot be reached; the episode has no result.
    """
    start_s = time.monotonic()
    drive = _EpisodeRun(task, policy, simulator, observer)
    view = simulator.reset(task.request.spec, loaded)
    end, detail = drive.run(view)
    return _measured(task, simulator, end, detail, drive, time.monotonic() - start_s)


@dataclass
class _EpisodeRun:
    """One run of an episode; measures the time of the policy's calls and counts its outputs."""

    task: EvalTask
    policy: Policy
    simulator: Simulator
    observer: PolicyCallObserver
    clipped: int = 0
    answers: int = 0
    act_s: float = 0.0
    attention: dict[int, Attention | None] = field(default_factory=dict)
    """Attention of the policy by the step of its answer."""
    held: Twist = _REST
    """Last twist that the policy requested, which the robot keeps while the policy thinks."""

    sensors: RigSensors | None = None
    """Sensors of the rig; `None` without a rig."""

    @property
    def rig(self) -> Rig | None:
        """Rig of the robot; `None` for the recorded camera."""
        return self.task.setup.view.rig

    @property
    def request(self) -> EvalRequest:
        return self.task.request

    def run(self, view: Observation) -> tuple[EvalEnd, str]:
        """Runs the episode; returns how it ended, and a description of the end."""
        try:
            self._begin(view)
            while view.end is None:
                view = self._act_once(view)
        except PolicyFailure as failure:
            return EvalEnd(failure.fault), failure.detail
        end = EvalEnd(view.end)
        words = f"{end} after {self.simulator.steps} steps, {view.distance_m:.2f} m from {self.request.spec.target_id}"
        return end, words

    def _begin(self, view: Observation) -> None:
        settings, spec = self.simulator.settings, self.request.spec
        info = EpisodeInfo(
            episode=spec.spec_id,
            seed=spec.seed,
            control_hz=settings.task.control_hz,
            max_steps=settings.task.max_steps,
            v_range_mps=(0.0, settings.robot.max_speed_mps),
            w_range_rps=(-settings.robot.max_yaw_rate_rps, settings.robot.max_yaw_rate_rps),
            fov_deg=settings.camera.fov_deg,
        )
        self.sensors = None if self.rig is None else RigSensors(self.rig, self.simulator)
        with self._policy_call(view):
            if isinstance(self.policy, PrivilegedPolicy):
                job = spec.job(settings, self.policy.expert)
                state = PrivilegedState(self.simulator, job, self.task.actions)
                self.policy.enter(state)
            self.policy.reset(self.request.instruction, info)

    def _act_once(self, view: Observation) -> Observation:
        """Calls `act` once and executes the returned actions."""
        observation = self._observation(view)
        before_s = self.act_s
        try:
            with self._policy_call(view):
                answer = self.policy.act(observation)
                self.attention[self.simulator.steps] = attention_of(self.policy)
        except PolicyFailure:
            if isinstance(observation, LazyInput) and observation.failure is not None:
                raise observation.failure from None
            raise
        if isinstance(observation, LazyInput):
            self.act_s -= observation.seconds  # the policy did not spend this time
        self.answers += 1
        view = self._wait(view, self.act_s - before_s)
        if view.end is not None:
            return view
        robot = self.simulator.settings.robot
        chunk = read_actions(answer, kind_of_actions(self.policy), robot.max_speed_mps, robot.max_yaw_rate_rps)
        self.clipped += chunk.beyond
        for twist in chunk.twists:
            view, self.held = self.simulator.step(twist), twist
            if view.end is not None:
                break
        return view

    def _wait(self, view: Observation, thought_s: float) -> Observation:
        """Moves the world for the latency of an answer, with the former command, and returns the view.

        The first answer of an episode takes no time, because the episode begins with the first action.

        Args:
            view: Current view.
            thought_s: Measured time of the answer, seconds.
        """
        latency = self.task.setup.latency
        if latency is None or self.answers == 1:
            return view
        seconds = thought_s if latency == REAL else latency / 1000
        for _ in range(math.ceil(seconds * self.simulator.settings.task.control_hz - _STEP_SLACK)):
            view = self.simulator.step(self.held)
            if view.end is not None:
                break
        return view

    def _observation(self, view: Observation) -> PolicyInput:
        words, step = self.request.instruction, self.simulator.steps
        if not uses_camera(self.policy):
            return cast(PolicyInput, {"instruction": words, "step": step})  # the policy does not use images
        seen = PolicyInput(instruction=words, step=step)
        if self.sensors is not None:
            seen["sensors"] = self.sensors.measure()
        seen["state"] = live_state(self.simulator, self.rig, seen.get("sensors"))
        if self.request.with_pose:
            seen["pose"] = odometry(self.simulator.track)
        if not shows_recorded_camera(self.rig, self.simulator.settings.camera):
            return seen
        return cast(PolicyInput, LazyInput(seen, lambda: self._render(view)))

    def _render(self, view: Observation) -> Frame:
        self.observer.before_render()
        try:
            return view.frame
        finally:
            self.observer.after_render()

    @contextmanager
    def _policy_call(self, view: Observation) -> Iterator[None]:
        """Wraps a policy call: notifies the observer, measures the time, converts exceptions to `PolicyFailure`."""
        self.observer.before_call(self.simulator, view)
        start_s = time.monotonic()
        try:
            yield
        except (PolicyFailure, ServerUnreachable):
            raise
        except Exception as error:
            raise PolicyFailure(PolicyFault.RAISED, describe_error(error)) from error
        finally:
            self.act_s += time.monotonic() - start_s
            self.observer.after_call()


def describe_error(error: BaseException) -> str:
    """Returns an exception in one line, with the file and line that raised it."""
    where = traceback.extract_tb(error.__traceback__)[-1:]
    place = "".join(f" ({Path(frame.filename).name}:{frame.lineno})" for frame in where)
    return (traceback.format_exception_only(error)[-1].strip() + place)[:500]


def thin_track(track: NDArray[np.float64], control_hz: int) -> tuple[tuple[float, float, float], ...]:
    """Returns x, y, yaw of a (frames, 7) track, sampled at 10 Hz and at the last frame."""
    rows = _track_steps(len(track), control_hz)
    yaws = yaws_of(track[rows])
    return tuple(
        (round(float(x), 3), round(float(y), 3), round(float(yaw), 3))
        for (x, y), yaw in zip(track[rows, :2], yaws, strict=True)
    )


def _track_steps(frames: int, control_hz: int) -> list[int]:
    every = max(1, round(control_hz / TRACK_HZ))
    return [*range(0, frames - 1, every), frames - 1]


def _thin_attention(
    attention: Mapping[int, Attention | None], frames: int, control_hz: int
) -> tuple[Attention | None, ...]:
    """Returns the last attention up to each row of `thin_track`; empty if the policy never states it."""
    if not any(attention.values()):
        return ()
    steps = np.array(sorted(attention))
    found = np.searchsorted(steps, _track_steps(frames, control_hz), side="right") - 1
    return tuple(attention[int(steps[max(0, place)])] for place in found)


def _measured(
    task: EvalTask,
    simulator: Simulator,
    end: EvalEnd,
    detail: str,
    drive: _EpisodeRun,
    seconds: float,
) -> EpisodeResult:
    spec, rules, track = task.request.spec, simulator.settings.task, simulator.track
    target, last = simulator.target, track[-1, :2]
    gaps = Goal.of(target, rules).distances(track[:, :2])
    start_m, final_m, least_m = float(gaps[0]), float(gaps[-1]), float(gaps.min())
    driven_m = measure.path_length_m(track)
    is_success = end is EvalEnd.SUCCESS
    has_goal, targets = not spec.is_false_premise, simulator.loaded.compiled.info.targets
    is_at_any = is_success or (has_goal and measure.stops_at_any(track, targets, spec.category, rules))
    return EpisodeResult(
        **request_fields(task),
        end=end,
        detail=detail,
        success=is_success,
        any_instance=is_at_any,
        num_steps=simulator.steps,
        spawn_dist_m=start_m,
        trajectory_length_m=driven_m,
        final_ne_m=final_m,
        min_ne_m=least_m,
        final_centroid_m=float(np.linalg.norm(last - np.asarray(target.centroid_m[:2]))),
        final_surface_m=float(footprint_distances(last, target.footprint_m)) if target.footprint_m else None,
        spl=None if spec.geodesic_m is None else measure.spl(is_success, spec.geodesic_m, driven_m),
        soft_spl=_soft_spl(spec, simulator, track=track, is_success=is_success, driven_m=driven_m),
        **(progresses(start_m, final_m, least_m, rules) if has_goal else _stop_progress(is_success)),
        contact_steps=simulator.contact_steps,
        clipped_actions=drive.clipped,
        act_ms=1000 * drive.act_s / max(1, drive.answers),
        seconds=seconds,
        trained_on=was_trained_on(drive.policy, spec),
        target_in_view=_is_in_view(simulator) if end is EvalEnd.TIMEOUT and has_goal else None,
        track=thin_track(track, rules.control_hz),
        attention=_thin_attention(drive.attention, len(track), rules.control_hz),
    )


def _is_in_view(simulator: Simulator) -> bool:
    """Returns whether the robot's camera shows the target."""
    return simulator.observe().target_mask.pixels >= simulator.settings.gains.min_mask_px


def request_fields(task: EvalTask) -> dict[str, Any]:
    """Returns the result fields that are known before the rollout."""
    request, spec = task.request, task.request.spec
    return {
        "spec_id": spec.spec_id,
        "spec_digest": request.spec_digest,
        "policy": task.policy,
        "variant": request.variant,
        "instruction": request.instruction,
        "split": spec.split,
        "scene": spec.scene,
        "tier": spec.tier,
        "category": spec.category,
        "target_id": spec.target_id,
        "template_id": spec.template_id,
        "categories_in_view": len(spec.categories_in_view),
        "geodesic_m": spec.geodesic_m,
    }


def progresses(start_m: float, final_m: float, least_m: float, task: TaskConfig) -> dict[str, Any]:
    """Returns the three progress metrics (docs/design/task.md#measures) from distances by the success measure."""
    radius_m = task.success_radius_m
    normalised = measure.progress(start_m - radius_m, max(0.0, least_m - radius_m)) if start_m > radius_m else 1.0
    return {
        "progress_final": measure.progress(start_m, final_m),
        "progress_max": measure.progress(start_m, least_m),
        "progress_normalised": normalised,
    }


def _stop_progress(is_success: bool) -> dict[str, Any]:
    """Returns the three progress metrics of an episode without a goal: 1 after a success, otherwise 0."""
    return dict.fromkeys(("progress_final", "progress_max", "progress_normalised"), float(is_success))


def _soft_spl(
    spec: EvalSpec, simulator: Simulator, track: NDArray[np.float64], is_success: bool, driven_m: float
) -> float | None:
    if spec.geodesic_m is None:
        return None
    if is_success:
        return measure.soft_spl(spec.geodesic_m, 0.0, driven_m)
    rules = simulator.settings.task
    left_m = measure.floor_distance_m(simulator.loaded.grid, track[-1, :2], simulator.target, rules)
    return 0.0 if left_m is None else measure.soft_spl(spec.geodesic_m, left_m, driven_m)
