"""Models of a verified instruction, which episodes and relabelled datasets record. Writes and verifies no sentence."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field

from schemas.base import Count, Line, Model, Name, Text
from schemas.language.sentence.mistakes import MistakeKind


class InstructionKind(StrEnum):
    """Purpose of an instruction."""

    GOAL = "goal"  # names the target of the episode
    ROUTE = "route"  # describes the driven path to the target
    FALSE_PREMISE = "false_premise"  # names an object that does not exist; the robot stops and reports it
    RECORDED = "recorded"  # instruction of the recording, because no new one fits the target


class Instruction(Model):
    """Verified instruction; a row of `instructions.parquet` without its episode."""

    kind: InstructionKind
    """Purpose."""
    text: Line
    """Sentence."""
    clean: Line | None = Field(default=None, exclude_if=lambda it: it is None)
    """Sentence without its typing or speech error; `None` and omitted if it has none."""
    mistake: MistakeKind | None = Field(default=None, exclude_if=lambda it: it is None)
    """Kind of the error; `None` and omitted if it has none."""
    language: Name
    """Code of the language."""
    register_name: Name
    """Register of the sentence pattern."""
    template_id: Name
    """Name of the sentence pattern."""
    held_out: bool
    """Whether only the split `test_paraphrase_ood` uses the pattern."""
    expression: Text
    """Meaning, as the JSON of `Expression`."""
    features: Line
    """Features of the expression, separated by commas."""
    is_minimal: bool
    """Whether no part of the expression can be dropped."""
    fits: Count
    """Number of objects of the scene that the expression fits."""
    distractors: Count
    """Number of other objects of the target's category in the scene."""

    @property
    def named_features(self) -> frozenset[str]:
        """Features of the expression."""
        return frozenset(filter(None, self.features.split(",")))

    @property
    def meant(self) -> str:
        """Sentence without its error."""
        return self.text if self.clean is None else self.clean
