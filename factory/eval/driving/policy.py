"""Interface of policies: `reset` with an instruction at the start of an episode, then `act` for each action.

A model receives camera images, the instruction and odometry only. This module runs no episodes.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, NotRequired, Protocol, TypedDict, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from factory.eval.driving.simulator import Simulator
from factory.eval.models.messages import Actions
from factory.eval.models.result import Attention, TrainingNote
from factory.eval.models.spec import EvalSpec
from factory.train.options import TrainingStarts
from schemas.job import Job
from schemas.terms import ExpertName


class PolicyInput(TypedDict):
    """Observation passed to a policy before each action."""

    rgb: NotRequired[NDArray[np.uint8]]
    """(640, 640, 3) sRGB, top row first; present if the robot has the recorded camera, e.g. without `--rig`."""
    depth: NotRequired[NDArray[np.float32]]
    """(640, 640) depth in metres along the optical axis; 0 where the ray hits nothing; present if `rgb` is."""
    sensors: NotRequired[dict[str, dict[str, NDArray[Any]]]]
    """Sensor name -> array name -> array of the latest measurement (docs/rigs.md#policies); only with `--rig`."""
    instruction: str
    step: int
    """Number of executed actions, from 0."""
    state: NotRequired[NDArray[np.float32]]
    """(5,) odometry and twist: x, y in metres and unwrapped yaw in radians of base_link in the frame of the start pose
    (x forward, y left), then v in m/s and w in rad/s, measured over the last step. It has the names and the order of
    `observation.state` in exports. Absent only for blind policies."""
    pose: NotRequired[NDArray[np.float64]]
    """(3,) pose of base_link in the frame of the start pose: x, y in metres, yaw in radians; only with `--pose`."""


@dataclass(frozen=True)
class EpisodeInfo:
    """Episode information for a policy; contains no information about the goal."""

    episode: str
    """Id of the spec."""
    seed: int
    """Random seed for the policy, equal for equal episodes."""
    control_hz: int
    max_steps: int
    v_range_mps: tuple[float, float]
    w_range_rps: tuple[float, float]
    fov_deg: float


@runtime_checkable
class Policy(Protocol):
    """Policy of an evaluation, built-in or written by a user.

    The optional attribute `actions` is `"continuous"` (the default) or `"tokens"`. The optional attribute `needs` lists
    inputs without which the policy is refused: `"rgb"` and `"depth"` of the recorded camera, sensors of the rig such as
    `"scan"`, or arrays of them such as `"scan/ranges"`. The optional attribute `attention` states, after `act`, where
    the policy located the named object: column and row as fractions of the image, 0..1 from the upper left corner, and
    a confidence, 0..1; videos show it. `None` means nowhere.
    """

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Starts an episode and clears the state of the previous one."""
        ...

    def act(self, observation: PolicyInput) -> Any:
        """Returns an action (v in m/s and w in rad/s, or two tokens 0..6), or a chunk (H, 2) of actions to execute."""
        ...


class BlindPolicy(ABC):
    """Base class of policies that use no camera images, so none are rendered for them."""

    knows: ClassVar[str] = "nothing"
    """Description of the information that the policy uses, for the results."""

    @abstractmethod
    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Starts an episode and clears the state of the previous one."""

    @abstractmethod
    def act(self, observation: PolicyInput) -> Any:
        """Returns an action; the observation contains the instruction and the step only."""


@dataclass(frozen=True)
class PrivilegedState:
    """Privileged state for a `PrivilegedPolicy`: the running simulation, including goal and map."""

    simulator: Simulator
    job: Job
    """Episode as a job, the input of the experts."""
    actions: Actions | None
    """Actions of an archived episode, for policies that replay them."""


class PrivilegedPolicy(BlindPolicy):
    """Base class of policies with more information than a model; only built-in policies may derive from it."""

    # a base class and not an attribute, because a user's class may use any attribute name for another purpose

    expert: ExpertName = ExpertName.PROPORTIONAL
    """Expert of the job in its `PrivilegedState`."""

    @abstractmethod
    def enter(self, state: PrivilegedState) -> None:
        """Receives the privileged state; called after the simulator's reset and before the policy's reset."""


class PolicyFault(StrEnum):
    """Kind of a policy failure."""

    RAISED = "policy_raised"  # the policy raised an exception, or its server replied with an error
    HUNG = "policy_hung"  # no output within the time limit
    INVALID = "policy_invalid"  # NaN, infinity, or a shape that is not valid for actions
    DIED = "policy_died"  # the policy process died during a call
    LOST = "policy_lost"  # the server closed the connection in an episode, and again in its repetition


class PolicyFailure(Exception):
    """Failure of a policy in one episode; counted in the results, does not stop the evaluation."""

    def __init__(self, fault: PolicyFault, detail: str) -> None:
        super().__init__(detail)
        self.fault = fault
        self.detail = detail


class ServerUnreachable(Exception):
    """The server of a policy cannot be reached; the evaluation stops and can be resumed."""


def training_of(policy: Policy) -> TrainingNote | None:
    """Returns what a policy states about its training; `None` if it states nothing."""
    note = getattr(policy, "training", None)
    return note if isinstance(note, TrainingNote) else None


def was_trained_on(policy: Policy, spec: EvalSpec) -> bool | None:
    """Returns whether a policy was trained on an episode; `None` if it does not state its training episodes."""
    starts = getattr(policy, "training_starts", None)
    if not isinstance(starts, TrainingStarts):
        return None
    return starts.holds(spec.scene_sha256, spec.target_id, spec.spawn_pose)


def attention_of(policy: Policy) -> Attention | None:
    """Returns where a policy located the named object in its last image; `None` if it does not say.

    Raises:
        PolicyFailure: The attribute `attention` is not `None` and not three numbers from 0 to 1.
    """
    value = getattr(policy, "attention", None)
    if value is None:
        return None
    try:
        column, row, confidence = (round(float(part), 3) for part in value)
    except (TypeError, ValueError):
        column = row = confidence = math.nan
    if not all(0 <= part <= 1 for part in (column, row, confidence)):
        raise PolicyFailure(
            PolicyFault.INVALID,
            f"the attribute `attention` is {value!r:.80}; column, row and confidence from 0 to 1 are expected, or None",
        )
    return column, row, confidence


def uses_camera(policy: Policy) -> bool:
    """Returns whether a policy receives camera images: all policies except those that derive from `BlindPolicy`."""
    return not isinstance(policy, BlindPolicy)


def needs_of(policy: Policy) -> tuple[str, ...]:
    """Returns the inputs without which a policy is refused."""
    return tuple(getattr(policy, "needs", ()))


def kind_of_actions(policy: Policy) -> str:
    """Returns the kind of actions of a policy, `continuous` or `tokens`."""
    return str(getattr(policy, "actions", "continuous"))
