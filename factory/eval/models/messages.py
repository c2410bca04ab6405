"""Evaluation requests, and messages between the evaluation process and its driver processes. Opens no pipe.

Equal requests have equal results. A message is one JSON line.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, ValidationError, model_validator

from factory.eval.models.result import EpisodeResult, Latency, TrainingNote, Variant
from factory.eval.models.spec import EvalSettings, EvalSpec
from schemas.base import Model, Name, Positive, Sha256
from schemas.terms import RendererKind
from schemas.view import ViewSettings

Actions = tuple[tuple[float, float], ...]
"""Actions (v, w) in m/s and rad/s, one pair per step."""
Key = tuple[str, Variant, str]
"""Spec id, variant and instruction, which identify an episode among the results of a policy."""


class EvalRequest(Model):
    """Episode and instruction for a policy."""

    spec: EvalSpec
    spec_digest: Sha256
    instruction: str
    variant: Variant = Variant.ORIGINAL
    recorded: Name | None = None
    """Archived episode whose actions `replay` or `playback` executes."""
    with_pose: bool = False

    @property
    def key(self) -> Key:
        return self.spec.spec_id, self.variant, self.instruction


class PolicyLimits(Model):
    """Time limits, passed to every policy on construction."""

    act_timeout_s: Positive = 10.0
    """Timeout of each action except the first, seconds."""
    load_timeout_s: Positive = 300.0
    """Timeout of a reset, and of the first action, which may compile models, seconds."""
    reconnect_s: Positive = 30.0
    """Timeout of reconnecting to a policy server, seconds."""


class EvalSetup(PolicyLimits):
    """Settings of all tasks of a campaign."""

    latency: Latency | None = Field(default=None, exclude_if=lambda it: it is None)
    """Time that passes in the simulation while the policy thinks: milliseconds, or `real` for the measured time. `None`
    and omitted if the simulation waits for the policy."""

    settings: EvalSettings
    renderer: RendererKind = "auto"
    view: ViewSettings = Field(default=ViewSettings(), exclude_if=lambda view: view == ViewSettings())
    """View settings of the observations; omitted for the recorded camera."""


class EvalTask(Model):
    """Episode to evaluate; the command, the workers and the driver processes use this same model."""

    number: Annotated[int, Field(ge=1)]
    """Number of the task in the campaign, from 1. With remote workers, the job of the task has this index."""
    policy: str
    """Name of the policy in the results."""
    reference: str
    """What the policy is: a built-in policy, a class or a server; equal to the name if none was given."""
    request: EvalRequest
    setup: EvalSetup
    actions: Actions | None = None
    """Actions of the archived episode that the request names; added when the task is sent."""


class DriverOrder(Model):
    """Order for a driver process: a task with the paths of its files on this machine."""

    task: EvalTask
    package: Path
    """Package of the compiled scene."""
    policy_file: Path | None = None
    """File of the policy, if its path differs from the one in the policy's name."""


class EvalReportKind(StrEnum):
    """Kind of a driver report."""

    READY = "ready"  # the renderer is open
    POLICY = "policy"  # the policy is created
    RESULT = "result"  # an episode has ended
    REFUSED = "refused"  # the policy cannot be created, or the spec does not match the dataset: a usage error
    AWAY = "away"  # the server of the policy cannot be reached
    DEFECT = "defect"  # internal error


class EvalReport(Model):
    """Report of a driver process."""

    kind: EvalReportKind
    number: int = -1
    """Number of the task; -1 in a report that belongs to no task."""
    detail: str = ""
    """Description: the renderer, the information used by the policy, or the error."""
    exit_code: int = 1
    """Exit code of the command, for `refused`."""
    result: EpisodeResult | None = None
    made_from: dict[str, str] = Field(default={}, max_length=1001)
    """Hashes of the policy, in a report of kind `policy`."""
    training: TrainingNote | None = None
    """Training of the policy, in a report of kind `policy`; `None` if it is not known."""

    @model_validator(mode="after")
    def _is_complete(self) -> Self:
        if (self.kind is EvalReportKind.RESULT) != (self.result is not None):
            raise ValueError(
                "the field `result` is required in a message of kind `result`, and not permitted in others"
            )
        return self


def to_line(message: Model) -> bytes:
    return message.model_dump_json().encode() + b"\n"


def read_report(line: bytes) -> EvalReport | None:
    """Decodes a report; returns `None` for any other line, such as the output of a library."""
    try:
        return EvalReport.model_validate_json(line)
    except ValidationError:
        return None
