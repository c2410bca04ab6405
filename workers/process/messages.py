"""Messages between supervisor and simulation, encoded as JSON lines. Opens no pipe."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, ValidationError, model_validator

from schemas.base import Bytes, Count, Line, Model, NonNegative, Sha256
from schemas.job import Job
from schemas.protocol.messages import MAX_DETAIL_CHARS, BuildOrder, Detail, PolicyWait, States
from schemas.terms import FailReason


class SimulationOrder(Model):
    """Order to simulate one attempt."""

    job: Job
    """Job to simulate."""
    scene_path: Path
    """Path of the compiled scene, already fetched and checked."""
    light_path: Path | None = None
    """Path of the light groups of the scene, already fetched and checked."""
    bundle_path: Path
    """Path of the finished bundle; the file appears there when it is complete."""
    sid: str
    """Session id of the worker, for the provenance."""
    eval_task: str | None = None
    """Evaluation task, unparsed."""
    attachment_path: Path | None = None
    """Path of the task's attachment, already fetched and checked."""
    states: States | None = None
    """States recording of the episode; the process renders its frames and does not simulate."""


class BuildTask(Model):
    """Order to build the package of a layout."""

    order: BuildOrder
    """Layout to build."""
    bundle_path: Path
    """Path of the finished package; the file appears there when it is complete."""


class SimulationReportKind(StrEnum):
    """Type of a report."""

    READY = "ready"  # the renderer is open, and the process accepts orders
    PROGRESS = "progress"  # the simulation has advanced
    SUCCESS = "success"  # the bundle is complete at its path
    FAILURE = "failure"  # the attempt produced no bundle


class SimulationReport(Model):
    """Report of a simulation process."""

    kind: SimulationReportKind
    """Type of the report."""
    step: Count = 0
    """Number of steps of the attempt."""
    waits: PolicyWait | None = None
    """Long wait for the policy of an evaluation, in the report `progress`."""
    reason: FailReason | None = None
    """Reason of a failure."""
    detail: Detail = ""
    """Explanation of a failure with measured values."""
    sha256: Sha256 | None = None
    """SHA-256 of the bundle."""
    size: Annotated[Bytes, Field(ge=1)] | None = None
    """Size of the bundle, bytes."""
    renderer: Line = ""
    """Description of the renderer, in the report `ready`."""
    seconds: NonNegative = 0.0
    """Wall time of the attempt, seconds."""

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if self.kind is SimulationReportKind.FAILURE and self.reason is None:
            raise ValueError("a failure needs a reason")
        if self.kind is SimulationReportKind.SUCCESS and (self.sha256 is None or self.size is None):
            raise ValueError("a success needs sha256 and size of its bundle")
        return self


def failure(reason: FailReason, detail: str, step: int = 0, seconds: float = 0.0) -> SimulationReport:
    """Returns the report of a failed attempt; the middle of a long detail is cut out."""
    detail = detail.replace("\0", "")
    if len(detail) > MAX_DETAIL_CHARS:
        half = MAX_DETAIL_CHARS // 2 - 3
        detail = f"{detail[:half]} ... {detail[-half:]}"
    return SimulationReport(kind=SimulationReportKind.FAILURE, reason=reason, detail=detail, step=step, seconds=seconds)


def to_line(message: SimulationOrder | BuildTask | SimulationReport) -> bytes:
    """Returns the message as one JSON line."""
    return message.model_dump_json().encode() + b"\n"


def read_report(line: bytes) -> SimulationReport | None:
    """Parses a line as a report; returns `None` for any other line, such as the output of a library."""
    try:
        return SimulationReport.model_validate_json(line)
    except ValidationError:
        return None
