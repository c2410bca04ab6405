"""Policy of an evaluation as the driver of episodes with corrections, with a time limit for each call.

Simulates nothing. A call that exceeds its limit ends this process, because Python cannot stop it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import cast

import numpy as np

from factory.eval.driving.action import read_actions
from factory.eval.driving.lazy_input import LazyInput
from factory.eval.driving.policy import (
    EpisodeInfo,
    Policy,
    PolicyFailure,
    PolicyFault,
    PolicyInput,
    ServerUnreachable,
    kind_of_actions,
    uses_camera,
)
from factory.eval.driving.rollout import describe_error
from factory.eval.models.messages import PolicyLimits
from factory.eval.policies.made_from import digest_of, hashes_of
from factory.eval.policies.registry import check_name, file_of, make_policy
from schemas.errors import UsageError
from schemas.job import Job
from schemas.support.geometry import planar_states
from schemas.support.numpy_types import Floats
from workers.experts.observation import Observation
from workers.geometry.slew import Twist
from workers.sim.correct import PolicyError, PolicyUnavailable

OnHang = Callable[[str], None]
"""Called with the description of a hang, before this process ends."""


def check_corrected(name: str) -> None:
    """Raises an error unless a policy can be corrected: it must see what a model sees, and no more.

    Raises:
        UsageError: the name is not valid, or the policy is an expert or replays recordings.
    """
    check_name(name)
    if name.partition(":")[0] in _NOT_CORRECTED:
        raise UsageError(f"policy {name} has nothing to correct; give a class, bc:OUT, or the address of a server")


_NOT_CORRECTED = ("expert", "planner", "replay", "playback")


class EvaluatedPolicy:
    """`PolicyDriver` of a policy that `--policy` names; it is created with the object.

    Args:
        name: reference of the policy.
        limits: time limits of its calls.
        on_hang: reports a call that exceeded its limit.

    Raises:
        UsageError: the policy cannot be created.
        PolicyUnavailable: its server cannot be reached.
    """

    def __init__(self, name: str, limits: PolicyLimits, on_hang: OnHang) -> None:
        check_corrected(name)
        self._limits, self._on_hang = limits, on_hang
        try:
            self._policy: Policy = make_policy(name, limits)
        except ServerUnreachable as error:
            raise PolicyUnavailable(str(error)) from error
        self.made_from = digest_of(hashes_of(name, self._policy, file_of(name)))
        """Digest of the hashes of what the policy consists of."""
        self._name, self._answers = name, 0

    def begin(self, job: Job, instruction: str) -> None:
        """Resets the policy for an episode.

        Raises:
            PolicyError: the policy failed.
            PolicyUnavailable: this is not the policy of the round, or its server cannot be reached.
        """
        correction = job.correction
        assert correction is not None
        if self.made_from != correction.made_from:
            raise PolicyUnavailable(
                f"policy {self._name} on this host has the hash {self.made_from[:12]}, that of the round is "
                f"{correction.policy} {correction.made_from[:12]}: copy the same files or checkpoint to this host"
            )
        self._job, self._instruction, self._answers = job, instruction, 0
        robot, task = job.robot, job.task
        info = EpisodeInfo(
            episode=job.episode_id,
            seed=int(job.correction_rng().integers(1 << 32)),
            control_hz=task.control_hz,
            max_steps=task.max_steps,
            v_range_mps=(0.0, robot.max_speed_mps),
            w_range_rps=(-robot.max_yaw_rate_rps, robot.max_yaw_rate_rps),
            fov_deg=job.camera.fov_deg,
        )
        with self._call("reset", self._limits.load_timeout_s):
            self._policy.reset(instruction, info)

    def act(self, view: Observation, track: Floats) -> Sequence[Twist]:
        """Returns the twists of the next answer, limited to the range of the robot.

        Raises:
            PolicyError: the policy failed.
            PolicyUnavailable: the server of the policy cannot be reached.
        """
        robot = self._job.robot
        limit_s = self._limits.act_timeout_s if self._answers else self._limits.load_timeout_s
        with self._call("act", limit_s):
            answer = self._policy.act(self._observation(view, track))
            twists = read_actions(
                answer, kind_of_actions(self._policy), robot.max_speed_mps, robot.max_yaw_rate_rps
            ).twists
        self._answers += 1
        w = robot.max_yaw_rate_rps
        return [
            Twist(float(np.clip(twist.v_mps, 0.0, robot.max_speed_mps)), float(np.clip(twist.w_rps, -w, w)))
            for twist in twists
        ]

    def _observation(self, view: Observation, track: Floats) -> PolicyInput:
        seen = PolicyInput(instruction=self._instruction, step=len(track) - 1)
        if not uses_camera(self._policy):
            return seen
        seen["state"] = planar_states(track, self._job.task.control_hz)[-1]
        return cast(PolicyInput, LazyInput(seen, lambda: view.frame))

    @contextmanager
    def _call(self, what: str, limit_s: float) -> Iterator[None]:
        """Limits the time of a call, and converts its exceptions."""
        timer = threading.Timer(limit_s, self._hang, (f"{what} exceeded {limit_s:g} s",))
        timer.daemon = True
        timer.start()
        try:
            yield
        except PolicyFailure as failure:
            raise PolicyError(f"{failure.fault}: {failure.detail}") from failure
        except ServerUnreachable as error:
            raise PolicyUnavailable(str(error)) from error
        except Exception as error:
            raise PolicyError(f"{PolicyFault.RAISED}: {what}: {describe_error(error)}") from error
        finally:
            timer.cancel()

    def _hang(self, detail: str) -> None:
        self._on_hang(f"{PolicyFault.HUNG}: {detail}")
        os._exit(1)
