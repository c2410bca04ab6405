"""Builds dataset rows for tests of statistics from the row of the smallest episode. Writes no file."""

from __future__ import annotations

import functools
from typing import Any

from factory.stats.rows import Rows
from schemas.dataset.meta import DatasetMeta
from schemas.dataset.rows import EpisodeSummary, FailedAttempt, summary_of
from schemas.job import episode_id
from schemas.plan import Plan, ScenePlan
from schemas.terms import Split
from tests.builders.bundle import parts_for
from tests.builders.dataset import NOW


def two_scenes(episodes: int = 4) -> Plan:
    """Returns a plan of the office and the hospital with the paper's tiers and splits."""
    scenes = (ScenePlan(name="office", episodes=episodes), ScenePlan(name="hospital", episodes=episodes))
    return Plan(name="two", scenes=scenes)


def episode_row(index: int = 1, **changes: Any) -> EpisodeSummary:
    """Returns the row of a near training episode with a chair in the office; `changes` replace fields."""
    return _smallest_row().model_copy(update={"index": index, "episode_id": episode_id(index), **changes})


def rows_of(
    episodes: list[EpisodeSummary], failures: list[FailedAttempt] | None = None, plan: Plan | None = None
) -> Rows:
    """Returns the rows as a reader of the dataset would return them."""
    plan = plan or two_scenes()
    meta = DatasetMeta(
        run=plan.run,
        plan_digest=plan.digest,
        seed=plan.seed,
        plan=plan,
        scenes={},
        episodes=len(episodes),
        planned=plan.episodes,
        failed_attempts=len(failures or ()),
        complete=len(episodes) == plan.episodes,
        software={},
        created_at=NOW,
        updated_at=NOW,
    )
    return Rows(meta, episodes, failures)


@functools.cache
def _smallest_row() -> EpisodeSummary:
    return summary_of(parts_for().sealed(), "0" * 64, 1000).model_copy(update={"split": Split.TRAIN_ID})
