"""Origins in damaged, foreign and joined exports."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from factory.dataset.reader import Dataset
from factory.export.origin import find_origin, origin_of
from schemas.errors import UsageError, WorldError
from tests.builders.dataset import make_dataset
from tests.builders.plan import small_plan


@pytest.fixture
def text(tmp_path: Path) -> str:
    make_dataset(tmp_path / "data", 1)
    return origin_of(Dataset(tmp_path / "data")[0]).to_json()


def written(path: Path, *texts: str) -> Path:
    path.parent.mkdir(parents=True)
    pq.write_table(pa.table({"origin": pa.array(texts, pa.string())}), path)
    return path.parents[1]


def test_lerobot_columns_that_remain_after_other_tools_are_enough(tmp_path: Path, text: str) -> None:
    assert find_origin(written(tmp_path / "a/data/x.parquet", text, ""), "1").to_json() == text
    assert find_origin(tmp_path / "a/data/x.parquet", "ep_000001").to_json() == text


def test_equal_ids_of_several_datasets_are_refused(tmp_path: Path, text: str) -> None:
    make_dataset(tmp_path / "other", 1, plan=small_plan(1).model_copy(update={"seed": 9}))
    other = origin_of(Dataset(tmp_path / "other")[0]).to_json()
    with pytest.raises(UsageError, match="has 2 episodes called ep_000001, from several datasets"):
        find_origin(written(tmp_path / "a/data/x.parquet", text, other), "1")
    assert find_origin(written(tmp_path / "b/data/x.parquet", text, text), "1").to_json() == text


def test_damaged_newer_and_oversized_origins_are_errors_with_a_remedy(tmp_path: Path, text: str) -> None:
    newer = json.dumps({**json.loads(text), "colour": "red"})
    with pytest.raises(WorldError, match=r"is damaged or newer at 'colour'.*use the version of minivla-factory"):
        find_origin(written(tmp_path / "a/data/x.parquet", newer), "1")
    with pytest.raises(WorldError, match="is larger than 1048576: export the dataset again"):
        find_origin(written(tmp_path / "b/data/x.parquet", text + " " * (1 << 20)), "1")
    with pytest.raises(WorldError, match="cannot be read as an export"):
        find_origin(written(tmp_path / "c/data/x.parquet", "{"), "1")
    (tmp_path / "d").mkdir()
    for name in ("a.tar", "a.parquet", "a.json.gz", "a.mcap"):
        file = tmp_path / "d" / name
        file.write_bytes(b"nothing" * 100)
        with pytest.raises(WorldError, match="cannot be read as an export"):
            find_origin(file, "1")


def test_a_folder_without_origins_is_refused(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old/export.json").write_text("{}")
    with pytest.raises(UsageError, match="states no origins of episodes: give an export of paper, lerobot"):
        find_origin(tmp_path / "old", "1")
    with pytest.raises(UsageError, match="does not exist; give the --out of `factory export`"):
        find_origin(tmp_path / "nothing", "1")
