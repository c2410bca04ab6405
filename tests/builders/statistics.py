"""Builds rows of a dataset for statistics from the smallest episode. Writes no file."""

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
    """Returns the row of an episode: near, training, a chair of the office, unless changed."""
    return _smallest_row().model_copy(update={"index": index, "episode_id": episode_id(index), **changes})


def rows_of(
    episodes: list[EpisodeSummary], failures: list[FailedAttempt] | None = None, plan: Plan | None = None
) -> Rows:
    """Returns rows as read from a dataset of a plan."""
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
