"""A small dataset of several splits, instructions and lengths, for the tests of exporters."""

from __future__ import annotations

from pathlib import Path

from coordinator.archive.opening import open_archive
from coordinator.tables.write import write_tables
from schemas.instruction.templates import instruction
from schemas.terms import Split
from tests.builders.bundle import BundleParts, job_for, parts_for
from tests.builders.dataset import NOW, archive_episode
from tests.builders.plan import small_plan

STEPS = (12, 15, 13, 20)
_SPLITS = (Split.TEST_PARAPHRASE_OOD, Split.TRAIN_ID, Split.TEST_ID, Split.TRAIN_ID)
_TEMPLATES = ("train_01", "train_02", "train_01", "train_02")


def episode_parts(index: int) -> BundleParts:
    """Returns the parts of an episode, numbered from 1."""
    plan = small_plan(len(STEPS))
    template = _TEMPLATES[index - 1]
    job = job_for(
        index,
        run=plan.run,
        plan_digest=plan.digest,
        split=_SPLITS[index - 1],
        template_id=template,
        instruction=instruction(template, "chair", "red"),
    )
    return parts_for(job, STEPS[index - 1])


def make_varied(root: Path) -> None:
    """Writes the dataset."""
    with open_archive(root) as archive:
        rows = [archive_episode(archive, episode_parts(index)) for index in range(1, len(STEPS) + 1)]
        write_tables(archive, small_plan(len(STEPS)), {"office": "b" * 64}, rows, [], NOW)
