"""What the evaluating process and its driving processes say to each other, one JSON line at a time. Opens no pipe."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, ValidationError, model_validator

from factory.eval.models.request import Actions, EvalRequest
from factory.eval.models.result import EpisodeResult
from factory.eval.models.spec import EvalSettings
from schemas.base import Model, Positive
from schemas.terms import RendererKind

__all__ = ["DriverOrder", "EvalReport", "EvalReportKind", "EvalTask", "Setup", "read_report", "to_line"]


class Setup(Model):
    """What holds for all tasks of a campaign."""

    settings: EvalSettings
    renderer: RendererKind = "auto"
    act_timeout_s: Positive = 10.0
    load_timeout_s: Positive = 300.0
    reconnect_s: Positive = 30.0


class EvalTask(Model):
    """One episode to evaluate; it has this form from the command to the driver process, on any machine."""

    number: Annotated[int, Field(ge=1)]
    """Place in the campaign, from 1; the index of its job on many machines."""
    policy: str
    request: EvalRequest
    setup: Setup
    actions: Actions | None = None
    """Those of the recorded episode that the request names; added when the task is handed out."""


class DriverOrder(Model):
    """A task for a driver process, with the files that it needs on this machine."""

    task: EvalTask
    package: Path
    """The compiled scene."""
    policy_file: Path | None = None
    """What the policy is made of, where it is not at the place that its name says."""


class EvalReportKind(StrEnum):
    """What a report is about."""

    READY = "ready"  # the renderer is open
    POLICY = "policy"  # the policy is made
    RESULT = "result"  # an episode is over
    REFUSED = "refused"  # the policy cannot be made, or the spec does not fit: the caller's mistake
    AWAY = "away"  # the policy's server cannot be reached
    DEFECT = "defect"  # our own mistake


class EvalReport(Model):
    """What a driving process has to say."""

    kind: EvalReportKind
    number: int = -1
    """Of the task."""
    detail: str = ""
    """In words: the renderer, the policy's knowledge, or what is wrong."""
    exit_code: int = 1
    """Of the command, for `refused`."""
    result: EpisodeResult | None = None

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if (self.kind is EvalReportKind.RESULT) != (self.result is not None):
            raise ValueError("the field `result` is required for a message of kind result and not allowed for others")
        return self


def to_line(message: Model) -> bytes:
    """Returns the message as one line."""
    return message.model_dump_json().encode() + b"\n"


def read_report(line: bytes) -> EvalReport | None:
    """Returns the report on a line; `None` for anything else, such as the chatter of a library."""
    try:
        return EvalReport.model_validate_json(line)
    except ValidationError:
        return None
