"""The columns of the metadata table: read at the first access, compact, and all from one version of the file."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from factory.dataset.columns import NAMES, Columns
from factory.dataset.reader import Dataset
from schemas.dataset.rows import EpisodeSummary
from schemas.errors import ArchiveCorrupt
from tests.builders.dataset import make_dataset


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset that no test changes."""
    root = tmp_path_factory.mktemp("columns") / "data"
    make_dataset(root, 3)
    return root


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A dataset that the test may damage."""
    make_dataset(tmp_path / "data", 3)
    return tmp_path / "data"


def change(root: Path, edit: Callable[[pa.Table], pa.Table]) -> None:
    path = root / "metadata.parquet"
    pq.write_table(edit(pq.read_table(path)), path)


def with_value(table: pa.Table, column: str, row: int, value: object) -> pa.Table:
    values = table[column].to_pylist()
    values[row] = value
    at = table.column_names.index(column)
    return table.set_column(at, table.schema.field(at), pa.array(values, table.schema.field(at).type))


def test_rows_are_those_of_the_file(shared: Path) -> None:
    columns = Columns(shared)
    assert [columns.row(n) for n in range(3)] == pq.read_table(shared / "metadata.parquet").select(NAMES).to_pylist()


def test_single_rows_of_a_large_table_equal_those_of_all_columns(own: Path) -> None:
    path = own / "metadata.parquet"
    table = pa.concat_tables([pq.read_table(path)] * 4000)
    pq.write_table(
        table.set_column(table.column_names.index("num_steps"), "num_steps", pa.array(range(12_000))), path, 999
    )
    columns, positions = Columns(own), (0, 998, 999, 11_999, 7, 11_998)  # the last two are read after all columns
    assert [columns.row(n) for n in positions] == pq.read_table(path).select(NAMES).take(positions).to_pylist()


def test_a_damaged_row_group_does_not_hide_single_rows_of_other_groups(own: Path) -> None:
    path = own / "metadata.parquet"
    pq.write_table(pa.concat_tables([pq.read_table(path)] * 2000), path, 1000)
    data = bytearray(path.read_bytes())
    chunk = pq.read_metadata(path).row_group(5).column(0)
    begin = chunk.dictionary_page_offset or chunk.data_page_offset
    data[begin : begin + chunk.total_compressed_size] = bytes(chunk.total_compressed_size)
    path.write_bytes(data)
    columns = Columns(own)
    assert columns.row(0)["episode_id"] == "ep_000001"
    with pytest.raises(ArchiveCorrupt, match="is damaged"):
        columns.row(5500)


@pytest.mark.parametrize("rows", [(1,), (0, 1, 2)])
@pytest.mark.parametrize("column", ["steps_visible", "geodesic_m", "target_in_view", "created_at", "software"])
def test_rows_with_missing_values_are_those_of_the_file(own: Path, column: str, rows: tuple[int, ...]) -> None:
    for row in rows:
        change(own, lambda table, row=row: with_value(table, column, row, None))  # type: ignore[misc]
    columns = Columns(own)
    assert [columns.row(n) for n in range(3)] == pq.read_table(own / "metadata.parquet").select(NAMES).to_pylist()


def test_the_metadata_table_has_the_values_of_the_file(shared: Path) -> None:
    table = pq.read_table(shared / "metadata.parquet").select(NAMES)
    assert Dataset(shared).metadata.to_pydict() == table.to_pydict()
    part = Dataset(shared).filter(episode=["ep_000003", "ep_000001"])
    assert part.metadata.to_pylist() == [table.to_pylist()[0], table.to_pylist()[2]]
    assert part.column("num_steps").type == pa.int64()  # a sum of compact integers would overflow


def test_repeated_text_is_stored_once_and_integers_are_small(shared: Path) -> None:
    columns = Columns(shared)
    assert columns["software"].dictionary.to_pylist() == list({columns.row(0)["software"]})
    assert columns["index"].type == pa.int8()


def test_integers_of_any_size_keep_their_value(own: Path) -> None:
    for value in (127, 128, 2**15, 2**31 - 1, 2**31, 2**40):
        change(own, lambda table, value=value: with_value(table, "file_bytes", 1, value))
        assert Columns(own).row(1)["file_bytes"] == value


def test_an_opened_dataset_keeps_its_rows_when_the_table_is_replaced(own: Path) -> None:
    opened = Dataset(own)
    (own / "new").mkdir()
    other = own / "new" / "metadata.parquet"
    pq.write_table(pq.read_table(own / "metadata.parquet").slice(0, 1), other)
    other.replace(own / "metadata.parquet")
    assert [episode.episode_id for episode in opened] == ["ep_000001", "ep_000002", "ep_000003"]
    assert len(Dataset(own)) == 1


def test_a_pickled_dataset_has_the_rows_of_the_opened_one(own: Path) -> None:
    opened = Dataset(own).filter(episode=["ep_000002", "ep_000003"])
    text = pickle.dumps(opened)
    (own / "metadata.parquet").unlink()
    copy = pickle.loads(text)
    assert [episode.summary for episode in copy] == [episode.summary for episode in opened]


def test_a_column_that_a_later_version_added_is_null_in_an_older_table(own: Path) -> None:
    change(own, lambda table: table.drop_columns(["spawn_surface_m", "final_surface_m", "target_in_view"]))
    assert Dataset(own)[0].summary.final_surface_m is None
    assert Dataset(own)[2].summary.target_in_view is None


def test_a_table_without_a_column_is_refused_when_it_is_opened(own: Path) -> None:
    change(own, lambda table: table.drop_columns(["split"]))
    with pytest.raises(ArchiveCorrupt, match=r"metadata\.parquet is damaged .*no column split"):
        Dataset(own)


@pytest.mark.parametrize(
    ("column", "value"),
    [("num_steps", 0), ("split", "elsewhere"), ("episode_id", "../../x"), ("scene", None), ("spawn_dist_m", -1.0)],
)
def test_an_invalid_row_is_found_when_it_is_read_and_the_others_can_be_read(
    own: Path, column: str, value: object
) -> None:
    change(own, lambda table: with_value(table, column, 1, value))
    data = Dataset(own)
    assert (data[0].episode_id, data[2].episode_id) == ("ep_000001", "ep_000003")
    with pytest.raises(
        ArchiveCorrupt, match=rf"metadata\.parquet is damaged \(1 wrong values, first at \('{column}',\)"
    ):
        data[1]


def test_a_damaged_page_is_reported_when_its_column_is_read(own: Path) -> None:
    path = own / "metadata.parquet"
    start = pq.read_metadata(path).row_group(0).column(NAMES.index("instruction")).dictionary_page_offset
    data = bytearray(path.read_bytes())
    data[start : start + 8] = b"\xff" * 8
    path.write_bytes(data)
    opened = Dataset(own)
    assert len(opened.filter(split="train_id")) == 3
    with pytest.raises(ArchiveCorrupt, match=r"metadata\.parquet is damaged"):
        opened[0]
    with pytest.raises(ArchiveCorrupt, match=r"metadata\.parquet is damaged"):
        _ = opened.metadata


def test_episodes_are_found_by_id_in_a_table_that_is_not_in_order(own: Path) -> None:
    change(own, lambda table: table.take([2, 0, 1]))
    data = Dataset(own)
    assert [data[name].episode_id for name in ("ep_000001", "ep_000002", "ep_000003")] == [
        "ep_000001",
        "ep_000002",
        "ep_000003",
    ]
    with pytest.raises(KeyError, match="ep_000004 is not one of the 3"):
        data["ep_000004"]
    with pytest.raises(KeyError, match="ep_000002 is not one of the 1"):
        data.filter(episode="ep_000001")["ep_000002"]


def test_the_digest_does_not_depend_on_the_order_of_rows(own: Path) -> None:
    before = Dataset(own).digest
    change(own, lambda table: table.take([2, 0, 1]))
    assert Dataset(own).digest == before == Dataset(own).meta.dataset_digest


def test_every_field_of_a_row_is_a_column() -> None:
    assert set(NAMES) == set(EpisodeSummary.model_fields)
