"""Models of routes: the meaning of each step, independent of words, and sub-instructions with frame spans."""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from schemas.base import Count, Line, Model, Name
from schemas.language.expression import Expression
from schemas.support.geometry import yaw_of
from schemas.support.numpy_types import Floats


class StepKind(StrEnum):
    """Kind of a step of a route."""

    TURN = "turn"  # change of heading
    CORNER = "corner"  # change of heading in a doorway into the next room
    FORWARD = "forward"  # straight for a distance
    TOWARDS = "towards"  # straight towards an object
    PAST = "past"  # straight past an object on the left or right
    DOOR = "door"  # through a doorway into the next room
    STOP = "stop"  # to the target, and stop


class RobotSide(StrEnum):
    """Side of the robot."""

    LEFT = "left"  # positive angles
    RIGHT = "right"  # negative angles


class TurnSize(StrEnum):
    """Size of a turn; docs/language/reference.md#routes has the angles."""

    SLIGHT = "slight"  # about 45 degrees
    PLAIN = "plain"  # about 90 degrees
    SHARP = "sharp"  # about 135 degrees
    AROUND = "around"  # about 180 degrees


class RouteStep(Model):
    """Meaning of one sub-instruction."""

    kind: StepKind
    """Kind of the step."""
    side: RobotSide | None = Field(default=None, exclude_if=lambda it: it is None)
    """Direction of a turn, or side of the object that is passed."""
    size: TurnSize | None = Field(default=None, exclude_if=lambda it: it is None)
    """Size of a turn."""
    named: Expression | None = Field(default=None, exclude_if=lambda it: it is None)
    """Object that the step names."""
    room: Name | None = Field(default=None, exclude_if=lambda it: it is None)
    """Type of the room behind a doorway; `None` if it is not named."""
    metres: Annotated[int, Field(ge=1, le=99)] | None = Field(default=None, exclude_if=lambda it: it is None)
    """Distance of `forward`, metres."""

    @model_validator(mode="after")
    def _has_its_arguments(self) -> RouteStep:
        given = {name for name in _ARGUMENTS if getattr(self, name) is not None}
        wanted, optional = ARGUMENTS[self.kind]
        if self.size is TurnSize.AROUND:
            wanted = wanted - {"side"}
        if not wanted <= given <= wanted | optional:
            raise ValueError(f"{self.kind} has the arguments {', '.join(sorted(wanted)) or 'none'}")
        return self


_ARGUMENTS = ("side", "size", "named", "room", "metres")
ARGUMENTS = MappingProxyType(
    {
        StepKind.TURN: (frozenset({"side", "size"}), frozenset()),
        StepKind.CORNER: (frozenset({"side"}), frozenset({"room"})),
        StepKind.FORWARD: (frozenset({"metres"}), frozenset()),
        StepKind.TOWARDS: (frozenset({"named"}), frozenset()),
        StepKind.PAST: (frozenset({"side", "named"}), frozenset()),
        StepKind.DOOR: (frozenset(), frozenset({"room"})),
        StepKind.STOP: (frozenset({"named"}), frozenset()),
    }
)
"""Required and optional arguments of each kind."""


class SubInstruction(Model):
    """Step of a route with its words and frames."""

    number: Annotated[int, Field(ge=1)]
    """Number of the step, from 1."""
    text: Line
    """Sentence of the step."""
    step: RouteStep
    """Meaning of the sentence."""
    start: Count
    """First frame."""
    end: Count
    """Frame after the last one."""


class RouteText(Model):
    """Route instruction: the whole text and its steps."""

    text: Line
    """All steps in one text."""
    language: Name
    """Code of the language."""
    register_name: Name
    """Register of the sentence pattern."""
    template_id: Name
    """Name of the sentence pattern."""
    held_out: bool
    """Whether only the split `test_paraphrase_ood` uses the pattern."""
    steps: tuple[SubInstruction, ...]
    """Steps in the order of the path; their spans cover all frames."""


class DrivenPath:
    """Planar path of an episode.

    Args:
        poses: (T, 7) poses of base_link in the world frame: x, y, z in metres and the quaternion w, x, y, z.
    """

    def __init__(self, poses: NDArray[np.float64]) -> None:
        self.poses = poses
        self.xy: Floats = np.asarray(poses[:, :2], np.float64)
        """(T, 2) positions, metres."""
        self.yaw: Floats = np.unwrap(yaw_of(poses))
        """(T,) continuous headings, radians."""
        steps = np.hypot(*np.diff(self.xy, axis=0).T)
        self.along: Floats = np.concatenate(([0.0], np.cumsum(steps)))
        """(T,) driven distance, metres."""

    def __len__(self) -> int:
        return len(self.xy)

    def pose(self, t: int) -> tuple[float, float, float]:
        """Returns x, y in metres and the heading in radians at a frame."""
        return float(self.xy[t, 0]), float(self.xy[t, 1]), float(self.yaw[t])
