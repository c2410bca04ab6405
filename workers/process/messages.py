"""What supervisor and simulation say to each other over a pipe, one JSON line at a time. Opens no pipe."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, ValidationError, model_validator

from schemas.base import Bytes, Count, Line, Model, NonNegative, Sha256
from schemas.job import Job
from schemas.terms import FailReason
from schemas.wire import MAX_DETAIL_CHARS, Detail

__all__ = ["SimulationOrder", "SimulationReport", "SimulationReportKind", "failure", "read_report", "to_line"]


class SimulationOrder(Model):
    """One attempt to simulate."""

    job: Job
    scene_path: Path
    """The compiled scene, already fetched and checked."""
    bundle_path: Path
    """Where the finished bundle shall lie; nothing lies there before it is whole."""
    sid: str
    """Session id of the worker, for the provenance."""
    eval_task: str | None = None
    """The task of an evaluation's job, as it came."""
    attachment_path: Path | None = None
    """The file that is attached to the task, fetched and checked."""


class SimulationReportKind(StrEnum):
    """What a report is about."""

    READY = "ready"  # the renderer is open; orders may come
    PROGRESS = "progress"  # the simulation has stepped
    SUCCESS = "success"  # the bundle lies where it was ordered
    FAILURE = "failure"  # the attempt brought no bundle


class SimulationReport(Model):
    """What a simulation has to say."""

    kind: SimulationReportKind
    step: Count = 0
    """Steps of the attempt so far."""
    reason: FailReason | None = None
    detail: Detail = ""
    sha256: Sha256 | None = None
    """Of the bundle."""
    size: Annotated[Bytes, Field(ge=1)] | None = None
    """Of the bundle, bytes."""
    renderer: Line = ""
    """What draws, when ready."""
    seconds: NonNegative = 0.0
    """Wall time of the attempt."""

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if self.kind is SimulationReportKind.FAILURE and self.reason is None:
            raise ValueError("a failure needs a reason")
        if self.kind is SimulationReportKind.SUCCESS and (self.sha256 is None or self.size is None):
            raise ValueError("a success needs sha256 and size of its bundle")
        return self


def failure(reason: FailReason, detail: str, step: int = 0, seconds: float = 0.0) -> SimulationReport:
    """Returns the report of an attempt without a bundle; a long detail loses its middle."""
    detail = detail.replace("\0", "")
    if len(detail) > MAX_DETAIL_CHARS:
        half = MAX_DETAIL_CHARS // 2 - 3
        detail = f"{detail[:half]} ... {detail[-half:]}"
    return SimulationReport(kind=SimulationReportKind.FAILURE, reason=reason, detail=detail, step=step, seconds=seconds)


def to_line(message: SimulationOrder | SimulationReport) -> bytes:
    """Returns the message as one line."""
    return message.model_dump_json().encode() + b"\n"


def read_report(line: bytes) -> SimulationReport | None:
    """Returns the report on a line; `None` for anything else, such as the chatter of a library."""
    try:
        return SimulationReport.model_validate_json(line)
    except ValidationError:
        return None
