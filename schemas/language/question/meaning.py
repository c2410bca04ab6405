"""Models of questions: the meaning of question, answer and reason, independent of words. Computes no answer."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field

from schemas.base import Count, Line, Model, Name
from schemas.language.expression import Expression


class QuestionKind(StrEnum):
    """Subject of a question."""

    VISIBLE = "visible"  # whether an object of a kind is visible
    OBJECT = "object"  # an object that is visible on a side
    WHERE = "where"  # direction and distance of the target
    NEXT = "next"  # next movement, and why
    FEASIBLE = "feasible"  # whether an instruction can be carried out


class SeenSide(StrEnum):
    """Part of the view."""

    LEFT = "left"  # left part of the view
    AHEAD = "ahead"  # middle of the view
    RIGHT = "right"  # right part of the view


class AnswerKind(StrEnum):
    """Meaning of an answer."""

    YES = "yes"  # affirmative
    NO = "no"  # negative
    THERE = "there"  # side and distance of the target
    UNSEEN = "unseen"  # the target is not visible
    OBJECT = "object"  # name of an object
    TURN_LEFT = "turn_left"  # the heading changes to the left
    TURN_RIGHT = "turn_right"  # the heading changes to the right
    TURN_AROUND = "turn_around"  # the heading changes by about 180 degrees
    DOORWAY = "doorway"  # through a doorway into the next room
    STRAIGHT = "straight"  # straight ahead
    STOP = "stop"  # the robot stops


class ReasonKind(StrEnum):
    """Meaning of a reason."""

    SEEN_AT = "seen_at"  # an object of the kind is visible on a side at a distance
    NONE_EXISTS = "none_exists"  # the scene has no such object
    NOT_IN_VIEW = "not_in_view"  # the scene has such an object, but none is visible
    OTHER_ROOM = "other_room"  # the target is in another room
    OUTSIDE = "outside"  # the target is outside of the image
    HIDDEN = "hidden"  # something hides the target
    GOAL_LEFT = "goal_left"  # the target is on the left
    GOAL_RIGHT = "goal_right"  # the target is on the right
    GOAL_AHEAD = "goal_ahead"  # the target is straight ahead
    CLOSER = "closer"  # the movement decreases the distance to the target
    REACHED = "reached"  # the robot is at the target
    ONE_FITS = "one_fits"  # one object fits the instruction
    NONE_FITS = "none_fits"  # no object fits the instruction
    SEVERAL_FIT = "several_fit"  # several objects fit the instruction


class QuestionMeaning(Model):
    """Meaning of a question with its answer and reason."""

    kind: QuestionKind
    """Subject."""
    answer: AnswerKind
    """Answer."""
    reason: ReasonKind | None = Field(default=None, exclude_if=lambda it: it is None)
    """Reason; `None` if the answer needs none."""
    named: Expression | None = Field(default=None, exclude_if=lambda it: it is None)
    """Object that the question or the answer names, by kind and perhaps colour."""
    side: SeenSide | None = Field(default=None, exclude_if=lambda it: it is None)
    """Side in question, answer or reason."""
    metres: Annotated[int, Field(ge=1, le=99)] | None = Field(default=None, exclude_if=lambda it: it is None)
    """Distance between camera and footprint, metres."""
    instruction: Line | None = Field(default=None, exclude_if=lambda it: it is None)
    """Instruction that a question quotes."""


class Question(Model):
    """Verified question; a row of `questions.parquet` without its episode."""

    question: Line
    """Question."""
    answer: Line
    """Answer."""
    reason: Line | None
    """Reason of the answer; `None` if it needs none."""
    language: Name
    """Code of the language."""
    template_id: Name
    """Name of the pattern of the question."""
    held_out: bool
    """Whether only the split `test_paraphrase_ood` uses the pattern."""
    start: Count
    """First frame for which the answer is computed."""
    end: Count
    """Frame after the last one."""
    meaning: QuestionMeaning
    """Meaning of question, answer and reason."""
