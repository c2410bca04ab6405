"""Statistics count the layouts of a family as one scene, and show the unseen-scene splits if they have episodes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.stats import measure_dataset
from schemas.plan import ScenePlan
from schemas.terms import Split
from tests.builders.bundle import BundleParts
from tests.builders.dataset import make_dataset
from tests.builders.plan import small_plan

SPLITS = (Split.TRAIN_ID, Split.TEST_UNSEEN_SCENE)


def in_its_layout(parts: BundleParts) -> BundleParts:
    """Returns the episode with the layout for its split as its scene."""
    layout = f"office_{SPLITS.index(parts.meta.job.split):05d}"
    job = parts.meta.job.model_copy(update={"scene": layout})
    return dataclasses.replace(parts, meta=parts.meta.model_copy(update={"job": job}))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("families") / "data"
    family = ScenePlan(name="office", layouts=2, episodes=4, splits=dict.fromkeys(SPLITS, 0.5))
    plan = small_plan(4).model_copy(update={"scenes": (family,)})
    make_dataset(root, 4, splits=SPLITS, plan=plan, change=in_its_layout, failures=[])
    return root


def test_statistics_have_one_row_for_a_family_and_rows_for_splits_with_episodes(root: Path) -> None:
    found = measure_dataset(root)
    assert [(row.group, row.n) for row in found.scenes] == [("office", 4), ("all", 4)]
    splits = {row.group: row.n for row in found.splits}
    assert splits["test_unseen_scene"] == splits["train_id"] == 2
    assert "test_unseen_scene_ood_obj" not in splits
    assert {(row.scene, row.split): row.archived for row in found.cells if row.archived} == {
        ("office", "train_id"): 2,
        ("office", "test_unseen_scene"): 2,
    }


def test_a_filter_by_family_selects_the_episodes_of_all_its_layouts(root: Path) -> None:
    data = Dataset(root)
    assert len(data.filter(scene="office")) == 4
    assert len(data.filter(scene="office_00001")) == len(data.filter(split="test_unseen_scene")) == 2


def test_the_card_shows_a_family_as_one_scene_and_describes_its_splits(root: Path) -> None:
    card = (root / "README.md").read_text()
    assert "| office | 4 |" in card
    assert "office_00001" not in card
    assert "| test_unseen_scene | as `test_id`, in layouts without an episode of the splits above | 2 | 2 |" in card
