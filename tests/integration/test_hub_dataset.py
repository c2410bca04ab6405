"""A dataset directory as the hubs read it: `datasets.load_dataset` takes the card's word and finds rows and columns."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest

from coordinator.dataset.tables import SIDE_COLUMN
from coordinator.summary import PUBLISHED_COLUMNS, EpisodeSummary
from tests.builders.dataset import make_dataset

Loaded = dict[str, dict[str, dict[str, list[Any]]]]
LOAD = """
import json, sys
from datasets import load_dataset
root, cache = sys.argv[1:]
found = {}
for name in ("default", "attempts"):
    loaded = load_dataset(root, name, cache_dir=cache)
    found[name] = {split: {"columns": rows.column_names, "rows": rows.to_list()} for split, rows in loaded.items()}
print(json.dumps(found, default=str))
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> Loaded:
    folder = tmp_path_factory.mktemp("hub")
    make_dataset(folder / "dataset", episodes=3)
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "HF_HOME": str(folder / "home"), "HOME": str(folder)}
    command = [sys.executable, "-c", LOAD, str(folder / "dataset"), str(folder / "cache")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    found: Loaded = json.loads(done.stdout)
    return found


def test_default_configuration_is_one_row_an_episode(loaded: Loaded) -> None:
    (table,) = loaded["default"].values()
    assert tuple(table["columns"][:13]) == PUBLISHED_COLUMNS
    assert table["columns"] == [*EpisodeSummary.model_fields, SIDE_COLUMN]
    assert [row["episode_id"] for row in table["rows"]] == ["ep_000001", "ep_000002", "ep_000003"]
    assert {row["split"] for row in table["rows"]} == {"train_id"}


def test_failed_attempts_are_a_configuration_of_their_own(loaded: Loaded) -> None:
    (table,) = loaded["attempts"].values()
    assert [row["reason"] for row in table["rows"]] == ["timeout"]
