"""What a policy is: told an instruction once, then shown a view and asked for an action, again and again.

A model sees the camera and the words and nothing else. Drives nothing itself.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, ClassVar, NotRequired, Protocol, TypedDict, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from factory.eval.driving.simulator import Simulator
from factory.eval.models.request import Actions
from schemas.job import Job
from schemas.terms import ExpertName

__all__ = [
    "BlindPolicy",
    "EpisodeInfo",
    "Policy",
    "PolicyFailure",
    "PolicyFault",
    "PolicyInput",
    "PrivilegedPolicy",
    "PrivilegedState",
    "ServerAway",
    "kind_of_actions",
    "uses_camera",
]


class PolicyInput(TypedDict):
    """What a policy is shown before each action."""

    rgb: NDArray[np.uint8]
    """(640, 640, 3) sRGB, top row first."""
    depth: NDArray[np.float32]
    """(640, 640) metres along the optical axis; 0 where nothing was hit."""
    instruction: str
    step: int
    """Actions carried out so far, from 0."""
    pose: NotRequired[NDArray[np.float64]]
    """(3,) x, y in metres and yaw in radians of base_link in the frame of its start; only with `--pose`."""


@dataclass(frozen=True)
class EpisodeInfo:
    """What a policy may know of an episode beside its instruction; nothing of the goal."""

    episode: str
    """Name of the spec."""
    seed: int
    """For the policy's own chances: the same episode gives the same seed."""
    control_hz: int
    max_steps: int
    v_range_mps: tuple[float, float]
    w_range_rps: tuple[float, float]
    fov_deg: float


@runtime_checkable
class Policy(Protocol):
    """A driver. The optional attribute `actions` is `"continuous"` (the default) or `"tokens"`."""

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Begins an episode and forgets the one before."""
        ...

    def act(self, observation: PolicyInput) -> Any:
        """Returns an action: v in m/s and w in rad/s, or two tokens 0..6; or a chunk (H, 2) of them to carry out."""
        ...


class BlindPolicy(ABC):
    """Base of a policy that declares that it uses no camera frames, so that none are rendered for it."""

    knows: ClassVar[str] = "nothing"
    """What its actions depend on, for the results."""

    @abstractmethod
    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Begins an episode and forgets the one before."""

    @abstractmethod
    def act(self, observation: PolicyInput) -> Any:
        """Returns an action; the observation has the instruction and the step only."""


@dataclass(frozen=True)
class PrivilegedState:
    """What a `PrivilegedPolicy` gets: the running simulation, goal and map included."""

    simulator: Simulator
    job: Job
    """The episode as the experts take it."""
    actions: Actions | None
    """Those of an archived episode, for policies that carry them out."""


class PrivilegedPolicy(BlindPolicy):
    """Base of a policy that declares more knowledge than a model has; only built-in policies may derive from it."""

    expert: ExpertName = ExpertName.PROPORTIONAL
    """Expert of the job in its `PrivilegedState`."""

    @abstractmethod
    def enter(self, situation: PrivilegedState) -> None:
        """Takes the state; called after the simulator's reset and before the policy's own."""


class PolicyFault(StrEnum):
    """How a policy failed an episode by itself."""

    RAISED = "policy_raised"  # it raised an exception, or its server answered with an error
    HUNG = "policy_hung"  # no answer within the time limit
    INVALID = "policy_invalid"  # NaN, infinity, or another shape than an action has
    DIED = "policy_died"  # the process it ran in died while it was asked
    LOST = "policy_lost"  # its server closed the connection in the middle of an episode, twice


class PolicyFailure(Exception):
    """A policy failed this episode: counted, never a crash."""

    def __init__(self, fault: PolicyFault, detail: str) -> None:
        super().__init__(detail)
        self.fault = fault
        self.detail = detail


class ServerAway(Exception):
    """A policy's server cannot be reached: no fault of an episode, the run stops and can be resumed."""


def uses_camera(policy: Policy) -> bool:
    """Returns whether a policy gets camera frames: all but those that declare that they use none."""
    return not isinstance(policy, BlindPolicy)


def kind_of_actions(policy: Policy) -> str:
    """Returns `continuous` or `tokens`: what the numbers of a policy mean."""
    return str(getattr(policy, "actions", "continuous"))
