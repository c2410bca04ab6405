"""The split tables: metadata rows by split with thumbnails, written atomically, reused and repaired."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from coordinator.archive.opening import open_archive
from coordinator.tables.card import names_split_tables, splits_at
from coordinator.tables.split_tables import (
    THUMBNAIL,
    FaultKind,
    find_faults,
    read_pictures,
    split_tables_of,
    write_split_tables,
)
from factory.dataset.reader import Dataset
from factory.push.files import plan_push
from factory.verify.dataset import Kind, verify
from schemas.dataset.meta import DatasetMeta
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.plan import PAPER_SPLITS
from schemas.storage.dataset_files import CARD_FILE, META_FILE, METADATA_FILE, is_part
from tests.builders.dataset import make_dataset

FIVE = list(PAPER_SPLITS)
TRAIN, TEST = "data/train_id-00000.parquet", "data/test_id-00000.parquet"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete dataset of seven episodes in five splits."""
    root = tmp_path_factory.mktemp("splits") / "data"
    make_dataset(root, 7, splits=FIVE)
    return root


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    """A copy of the dataset that the test may change."""
    shutil.copytree(made, tmp_path / "data")
    return tmp_path / "data"


def found_in(root: Path, deep: bool = False) -> list[tuple[Kind, str]]:
    """Returns the findings of a verification about the split tables."""
    return [(found.kind, found.file) for found in verify(root, deep).findings if found.file.startswith("data/")]


def state_of(root: Path) -> dict[str, tuple[int, bytes]]:
    return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in sorted((root / "data").iterdir())}


def rewrite(root: Path, **options: bool) -> None:
    with open_archive(root) as archive:
        write_split_tables(archive, **options)


def flip(path: Path, place: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 0xFF
    path.write_bytes(data)


def test_the_tables_together_contain_the_rows_of_the_metadata(root: Path) -> None:
    tables = [pq.read_table(path) for path in sorted((root / "data").iterdir())]
    rows = pa.concat_tables(tables).drop_columns([THUMBNAIL]).sort_by("index")
    assert rows.replace_schema_metadata().equals(pq.read_table(root / METADATA_FILE).replace_schema_metadata())
    assert [path.name for path in sorted((root / "data").iterdir())] == sorted(f"{s}-00000.parquet" for s in FIVE)


def test_a_thumbnail_is_the_first_frame_at_a_quarter_of_the_width(root: Path) -> None:
    episode = next(iter(Dataset(root).filter(split="test_id")))
    with episode, Image.open(io.BytesIO(read_pictures(root / TEST)[episode.summary.content_digest])) as picture:
        assert (picture.format, picture.size) == ("JPEG", (160, 160))
        frame = Image.fromarray(episode.rgb(0)).reduce(4)
        differences = [abs(a - b) for a, b in zip(picture.tobytes(), frame.tobytes(), strict=True)]
    assert sum(differences) / len(differences) < 4


def test_the_same_episodes_give_the_same_files(root: Path, tmp_path: Path) -> None:
    make_dataset(tmp_path / "again", 7, splits=FIVE)
    assert [data for _, data in state_of(root).values()] == [data for _, data in state_of(tmp_path / "again").values()]


def test_current_tables_are_not_rewritten(root: Path) -> None:
    before = state_of(root)
    rewrite(root)
    rewrite(root, deep=True)
    assert state_of(root) == before


def test_thumbnails_are_kept_if_the_rows_of_their_episodes_change(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 3, planned=5)
    root = tmp_path / "data"
    old = read_pictures(root / TRAIN)
    for path in (root / "episodes").iterdir():
        path.unlink()  # without its episode file, a thumbnail cannot be computed again
    table = pq.read_table(root / METADATA_FILE)
    renamed = table.set_column(3, "instruction", pa.array(["Go there."] * 3))
    pq.write_table(renamed, root / METADATA_FILE)
    rewrite(root)
    assert pq.read_table(root / TRAIN)["instruction"].to_pylist() == ["Go there."] * 3
    assert read_pictures(root / TRAIN) == old


def test_thumbnails_not_made_by_the_deadline_are_made_by_the_next_call(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 2, with_split_tables=False)
    root = tmp_path / "data"
    with open_archive(root) as archive:
        write_split_tables(archive, seconds=-1.0)
        assert pq.read_table(root / TRAIN)[THUMBNAIL].to_pylist() == [None, None]
        (fault,) = find_faults(root)
        assert (fault.kind, fault.text) == (FaultKind.OUTDATED, "no thumbnail of ep_000001 and 1 more")
        write_split_tables(archive)
    assert len(read_pictures(root / TRAIN)) == 2
    assert list(find_faults(root, deep=True)) == []


def test_an_episode_that_a_gateway_keeps_has_a_row_without_a_thumbnail(root: Path) -> None:
    episode = next(iter(Dataset(root).filter(split="test_id"))).episode_id
    (root / "episodes" / f"{episode}.zip").rename(root.parent / "kept.zip")
    (root / TEST).unlink()
    rewrite(root)
    assert list(find_faults(root, deep=True)) == []
    assert len(read_pictures(root / TEST)) == pq.read_metadata(root / TEST).num_rows - 1
    (root.parent / "kept.zip").rename(root / "episodes" / f"{episode}.zip")
    rewrite(root)
    assert len(read_pictures(root / TEST)) == pq.read_metadata(root / TEST).num_rows


def test_each_range_of_episode_numbers_has_a_separate_file(root: Path) -> None:
    names = [(table.name, table.rows.num_rows) for table in split_tables_of(root, shard_episodes=5)]
    assert names == [
        *((f"data/{split}-00000.parquet", 1) for split in FIVE),
        *((f"data/{split}-00001.parquet", 1) for split in FIVE[:2]),
    ]


def test_metadata_that_is_not_in_ascending_order_is_refused(root: Path) -> None:
    table = pq.read_table(root / METADATA_FILE)
    pq.write_table(table.take([6, 5, 4, 3, 2, 1, 0]), root / METADATA_FILE)
    with pytest.raises(ArchiveCorrupt, match="not in ascending order"):
        list(split_tables_of(root, shard_episodes=2))


DAMAGE = {
    "missing": (lambda path: path.unlink(), Kind.MISSING, False),
    "cut off": (lambda path: path.write_bytes(path.read_bytes()[:-10]), Kind.DAMAGED, False),
    "empty": (lambda path: path.write_bytes(b""), Kind.DAMAGED, False),
    "a flipped bit in the footer": (lambda path: flip(path, -200), Kind.DAMAGED, False),
    "a flipped bit in a page": (lambda path: flip(path, 2000), Kind.DAMAGED, True),
    "other rows": (
        lambda path: path.write_bytes(path.with_name("val_id-00000.parquet").read_bytes()),
        Kind.CONTRADICTION,
        False,
    ),
    "an invalid picture": (lambda path: spoil_picture(path), Kind.DAMAGED, True),
}


def spoil_picture(path: Path) -> None:
    table = pq.read_table(path)
    pictures = pa.array(
        [{"bytes": b"no picture", "path": "x.jpg"}] * table.num_rows, table.schema.field(THUMBNAIL).type
    )
    place = table.schema.get_field_index(THUMBNAIL)
    pq.write_table(table.set_column(place, table.schema.field(THUMBNAIL), pictures), path)


@pytest.mark.parametrize("what", DAMAGE)
def test_verify_finds_damage_and_rewriting_repairs_it(root: Path, what: str) -> None:
    whole = (root / TEST).read_bytes()
    spoil, kind, is_deep = DAMAGE[what]
    spoil(root / TEST)
    if not is_deep:
        assert found_in(root) == [(kind, TEST)]
    assert found_in(root, deep=True) == [(kind, TEST)]
    rewrite(root, deep=True)
    assert (root / TEST).read_bytes() == whole
    assert found_in(root, deep=True) == []


def test_a_surplus_file_is_found_and_moved_away(root: Path) -> None:
    (root / "data" / "train_id-00007.parquet").write_bytes((root / TRAIN).read_bytes())
    (root / "data" / "notes.txt").write_text("mine")
    found = {(finding.kind, finding.file) for finding in verify(root).findings}
    assert found == {(Kind.SURPLUS, "data/notes.txt"), (Kind.SURPLUS, "data/train_id-00007.parquet")}
    rewrite(root)
    assert verify(root).ok
    assert sorted(path.name.split(".")[0] for path in (root / "quarantine").iterdir() if "reason" not in path.name) == [
        "notes",
        "train_id-00007",
    ]


def test_a_dataset_of_an_earlier_version_without_split_tables_is_valid(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 3, with_split_tables=False)
    assert verify(tmp_path / "data", deep=True).ok
    assert not names_split_tables((tmp_path / "data" / CARD_FILE).read_text())


def test_tables_that_lag_behind_an_active_run_are_valid(root: Path) -> None:
    path = root / META_FILE
    meta = DatasetMeta.model_validate_json(path.read_text())
    path.write_text(meta.model_copy(update={"complete": False, "dataset_digest": None}).model_dump_json())
    (root / TRAIN).unlink()
    assert verify(root).ok
    flip(root / TEST, -200)
    assert [finding.kind for finding in verify(root).findings] == [Kind.DAMAGED]


def test_missing_split_tables_are_added_to_the_card(root: Path) -> None:
    card = (root / CARD_FILE).read_text()
    (root / CARD_FILE).write_text(card.replace("path: data/val_id-*.parquet", "path: gone-*.parquet"))
    rewrite(root)
    assert (root / CARD_FILE).read_text() == card
    assert splits_at(root) == tuple(map(str, PAPER_SPLITS))


def test_files_named_by_the_card_are_part_of_the_dataset_and_are_pushed(root: Path) -> None:
    assert is_part("data")
    pushed = {file.name for file in plan_push(root, "export.json").files}
    assert {f"data/{split}-00000.parquet" for split in FIVE} <= pushed


def test_a_failed_write_leaves_the_former_file_whole(root: Path) -> None:
    before = state_of(root)
    with open_archive(root) as archive:
        (root / TEST).unlink()
        (root / TEST).mkdir()
        with pytest.raises(WorldError):
            write_split_tables(archive)
        (root / TEST).rmdir()
        assert {name for name in before if name != "test_id-00000.parquet"} == set(state_of(root))
        write_split_tables(archive)
    assert [data for _, data in state_of(root).values()] == [data for _, data in before.values()]
