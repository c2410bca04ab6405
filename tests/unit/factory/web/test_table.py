"""The table of episodes selects and sorts like a loop over the rows."""

from __future__ import annotations

import dataclasses

import pyarrow as pa
import pytest

from factory.dataset.reader import Dataset
from factory.web.table import SORTED, EpisodeTable, TableQuery, parse_query
from schemas.errors import UsageError
from schemas.terms import Split
from tests.builders.bundle import BundleParts
from tests.builders.dataset import make_dataset


def vary(parts: BundleParts) -> BundleParts:
    """Gives each episode a different instruction and final error, which sort in a different order than the episodes."""
    index = parts.meta.job.index
    job = parts.meta.job.model_copy(update={"instruction": f"Go to CHAIR {7 * index % 5}."})
    error_m = round(3 * index % 5 / 10, 2)
    rollout = parts.meta.rollout.model_copy(update={"final_ne_m": error_m, "final_surface_m": error_m / 2})
    return dataclasses.replace(parts, meta=parts.meta.model_copy(update={"job": job, "rollout": rollout}))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("table") / "data"
    make_dataset(root, 6, splits=(Split.TRAIN_ID, Split.VAL_ID), change=vary)
    return Dataset(root)


@pytest.mark.parametrize("descending", [False, True])
@pytest.mark.parametrize("column", SORTED)
def test_sorting_by_a_column_gives_the_order_of_its_values(dataset, column, descending):
    found = EpisodeTable(dataset).select(TableQuery(sort=column, descending=descending))
    values = [dataset.column(column)[int(row)].as_py() for row in found]
    assert values == sorted(values, reverse=descending)
    assert sorted(found.tolist()) == list(range(6))


def test_filters_and_text_are_combined(dataset):
    table = EpisodeTable(dataset)
    found = table.select(TableQuery({"split": "train_id"}, text="chair 2"))
    rows = [row for row in dataset.rows() if row["split"] == "train_id" and "CHAIR 2" in row["instruction"]]
    assert [row["episode_id"] for row in table.rows(found)] == [row["episode_id"] for row in rows] != []


def test_a_family_selects_all_its_layouts(tmp_path):
    make_dataset(tmp_path / "data", 4, change=vary)
    table = EpisodeTable(Dataset(tmp_path / "data"))
    scenes = pa.array(["home_00000", "home_00001", "office", "home_00000"]).dictionary_encode()
    with pytest.MonkeyPatch.context() as patch:
        column = table.dataset.column
        patch.setattr(Dataset, "column", lambda _, name: scenes if name == "scene" else column(name))
        assert table.select(TableQuery({"scene": "home"})).tolist() == [0, 1, 3]
        assert table.select(TableQuery({"scene": "home_00001"})).tolist() == [1]
        assert table.values("scene") == ["home", "home_00000", "home_00001", "office"]


def test_a_value_that_no_episode_has_selects_nothing(dataset):
    table = EpisodeTable(dataset)
    assert not len(table.select(TableQuery({"scene": "nowhere"})))
    assert table.rows(table.select(TableQuery(text="\U0001f916%_\\"))) == []


def test_flagged_episodes_are_selected_in_the_order_of_the_table(dataset):
    query = TableQuery(descending=True, flagged=True)
    table = EpisodeTable(dataset)
    found = table.select(query, {"ep_000002", "ep_000005", "ep_999999"})
    assert [row["episode_id"] for row in table.rows(found)] == ["ep_000005", "ep_000002"]


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"scenee": "office"}, "did you mean 'scene'?"),
        ({"sort": "worker"}, "is not a column"),
        ({"page": "-1"}, "not a page number"),
        ({"page": "٣"}, "not a page number"),
        ({"page": "1" * 30}, "not a page number"),
        ({"q": "a" * 201}, "at most 200"),
    ],
)
def test_a_wrong_query_is_refused_with_the_reason(given, text):
    with pytest.raises(UsageError, match=text.replace("?", r"\?")):
        parse_query(given)


def test_a_query_is_read_from_the_url():
    given = {"scene": "office", "tier": "", "q": " go ", "sort": "num_steps", "order": "desc", "page": "3"}
    assert parse_query(given) == TableQuery({"scene": "office"}, "go", "num_steps", True, 3)
