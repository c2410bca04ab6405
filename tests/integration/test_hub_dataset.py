"""A dataset directory on the Hub: `datasets.load_dataset` loads the splits and decodes the thumbnails."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from coordinator.tables.split_tables import THUMBNAIL
from coordinator.tables.write import SIDE_COLUMN
from schemas.dataset.rows import PUBLISHED_COLUMNS, EpisodeSummary
from schemas.plan import PAPER_SPLITS
from schemas.terms import Split
from tests.builders.dataset import make_dataset

Loaded = dict[str, dict[str, dict[str, Any]]]
LOAD = """
import json, sys
from datasets import get_dataset_config_names, load_dataset
root, cache = sys.argv[1:]
found = {}
for name in get_dataset_config_names(root):
    loaded = load_dataset(root, name, cache_dir=cache)
    found[name] = {}
    for split, rows in loaded.items():
        pictures = [row["thumbnail"] for row in rows] if "thumbnail" in rows.column_names else []
        found[name][split] = {
            "columns": rows.column_names,
            "rows": rows.remove_columns([c for c in rows.column_names if c == "thumbnail"]).to_list(),
            "thumbnails": [[type(p).__module__.split(".")[0], p.mode, *p.size, p.getpixel((80, 99))] for p in pictures],
        }
print(json.dumps(found, default=str))
"""


def load(root: Path, folder: Path) -> Loaded:
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(folder / "home"), "HOME": str(folder)}
    command = [sys.executable, "-c", LOAD, str(root), str(folder / "cache")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    found: Loaded = json.loads(done.stdout)
    return found


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> Loaded:
    folder = tmp_path_factory.mktemp("hub")
    make_dataset(folder / "dataset", episodes=7, splits=[*PAPER_SPLITS, Split.TRAIN_ID, Split.TEST_ID])
    return load(folder / "dataset", folder)


def test_each_split_is_loaded_with_exactly_its_episodes(loaded: Loaded) -> None:
    assert list(loaded["default"]) == [str(split) for split in PAPER_SPLITS]
    for split, table in loaded["default"].items():
        assert {row["split"] for row in table["rows"]} == {split}
    named = {split: [row["episode_id"] for row in table["rows"]] for split, table in loaded["default"].items()}
    assert named["train_id"] == ["ep_000001", "ep_000006"]
    assert named["test_id"] == ["ep_000003", "ep_000007"]
    assert sum(map(len, named.values())) == 7


def test_each_row_has_a_thumbnail_that_decodes_to_the_first_frame(loaded: Loaded) -> None:
    for table in loaded["default"].values():
        assert len(table["thumbnails"]) == len(table["rows"])
        for library, mode, width, height, (red, green, blue) in table["thumbnails"]:
            assert (library, mode, width, height) == ("PIL", "RGB", 160, 160)
            assert green > max(red, blue)  # the first synthetic frames are green


def test_columns_are_those_of_the_metadata_and_the_thumbnail(loaded: Loaded) -> None:
    for table in loaded["default"].values():
        assert tuple(table["columns"][:13]) == PUBLISHED_COLUMNS
        assert table["columns"] == [*EpisodeSummary.model_fields, SIDE_COLUMN, THUMBNAIL]


def test_the_whole_table_and_the_failed_attempts_are_separate_configurations(loaded: Loaded) -> None:
    assert list(loaded) == ["default", "metadata", "attempts"]
    (table,) = loaded["metadata"].values()
    assert [row["episode_id"] for row in table["rows"]] == [f"ep_{index:06d}" for index in range(1, 8)]
    (table,) = loaded["attempts"].values()
    assert [row["reason"] for row in table["rows"]] == ["timeout"]


def test_splits_without_episodes_and_a_record_without_failures_do_not_break_loading(tmp_path: Path) -> None:
    make_dataset(tmp_path / "dataset", episodes=2, splits=[Split.VAL_ID, Split.TEST_OOD_OBJ], failures=())
    loaded = load(tmp_path / "dataset", tmp_path)
    assert {name: list(splits) for name, splits in loaded.items()} == {
        "default": ["val_id", "test_ood_obj"],
        "metadata": ["train"],
    }


def test_a_dataset_whose_run_has_not_ended_loads_as_one_table(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    make_dataset(root, episodes=2, planned=3, splits=[Split.VAL_ID, Split.TEST_ID], with_split_tables=False)
    loaded = load(root, tmp_path)
    assert [row["split"] for row in loaded["default"]["train"]["rows"]] == ["val_id", "test_id"]
