"""The spec of an episode: one definition of its fields, and the names under which files and tables publish them."""

from __future__ import annotations

import json

import pytest

from factory.eval.models.spec import EvalSpec
from schemas.base import Model
from schemas.dataset.rows import EpisodeSummary, FailedAttempt
from schemas.episode_spec import EpisodeSpec, columns_of
from schemas.job import Job
from schemas.terms import Split, Tier
from tests.builders.bundle import job_for
from tests.builders.dataset import failure
from tests.builders.eval_results import spec_of
from tests.builders.statistics import episode_row

FIELDS = {"scene", "tier", "split", "category", "target_id", "colour", "template_id", "instruction"}


@pytest.mark.parametrize("message", [job_for(), spec_of()], ids=["job", "evaluation spec"])
def test_the_fields_of_the_spec_stay_flat_in_published_json(message: Model) -> None:
    published = json.loads(message.model_dump_json())
    assert {name for name in FIELDS if isinstance(published[name], str)} == FIELDS
    assert type(message).model_validate_json(json.dumps(published, sort_keys=True)) == message


@pytest.mark.parametrize("model", [Job, EvalSpec])
def test_jobs_and_evaluation_specs_define_no_field_of_the_spec_again(model: type[Model]) -> None:
    assert set(EpisodeSpec.model_fields) == FIELDS
    assert issubclass(model, EpisodeSpec)
    assert not FIELDS & model.__annotations__.keys()


def test_the_spec_of_a_job_lacks_the_other_fields_of_the_job_and_changes_are_validated() -> None:
    job = job_for(split=Split.VAL_ID)
    spec = EpisodeSpec.of(job, instruction="")
    assert type(spec) is EpisodeSpec
    assert (spec.scene, spec.split, spec.target_id, spec.instruction) == (job.scene, Split.VAL_ID, job.target_id, "")
    with pytest.raises(ValueError, match="tier"):
        EpisodeSpec.of(job, tier="nowhere")


def test_table_columns_keep_their_published_names() -> None:
    job = job_for()
    renamed = {"spawn_tier": job.tier, "target_category": job.category}
    same = FIELDS - {"tier", "category"}
    assert columns_of(job, EpisodeSummary) == renamed | {name: getattr(job, name) for name in same}
    in_attempts = {"scene", "split", "target_id"}
    assert columns_of(job, FailedAttempt) == renamed | {name: getattr(job, name) for name in in_attempts}


@pytest.mark.parametrize("row", [episode_row(), failure(1)], ids=["metadata", "attempts"])
def test_table_columns_admit_what_the_spec_admits(row: Model) -> None:
    longest = EpisodeSpec(
        scene="s" * 64,
        tier=Tier.FAR,
        split=Split.TEST_OOD_OBJ,
        category="c" * 64,
        target_id="t" * 64,
        colour="o" * 64,
        template_id="p" * 64,
        instruction="i" * 500,
    )
    columns = columns_of(longest, type(row))
    assert type(row).model_validate(row.model_dump() | columns).model_dump().items() >= columns.items()
