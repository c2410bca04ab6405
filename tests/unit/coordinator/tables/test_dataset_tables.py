"""The tables of a dataset, read back with common tools."""

from __future__ import annotations

import json
from datetime import timedelta
from pathlib import Path

import pyarrow.parquet as pq
import pytest
import yaml

from coordinator.archive.opening import open_archive
from coordinator.expansion.instances import Side
from coordinator.tables.write import SIDE_COLUMN, write_tables
from schemas.appearance import Appearance, LightRanges
from schemas.dataset.meta import DATASET_FORMAT, DatasetMeta, GateOutcome, git_commit, read_dataset_meta
from schemas.dataset.rows import PUBLISHED_COLUMNS, EpisodeSummary, summary_of
from schemas.encoding.digest import dataset_digest
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.language.language_file import LanguageSpec
from tests.builders.bundle import job_for, parts_for
from tests.builders.dataset import NOW, failure
from tests.builders.plan import small_plan


def row(index: int) -> EpisodeSummary:
    meta = parts_for().meta.model_copy(update={"episode_id": f"ep_{index:06d}", "job": job_for(index)})
    return summary_of(meta, f"{index:064x}", 1000 + index)


def write(root: Path, episodes: int, planned: int) -> DatasetMeta:
    with open_archive(root) as archive:
        rows = (row(index) for index in range(1, episodes + 1))
        return write_tables(archive, small_plan(planned), {"office": "b" * 64}, rows, [failure(2)], NOW)


def test_published_columns_come_first_and_in_order(tmp_path: Path) -> None:
    write(tmp_path, 3, 3)
    table = pq.read_table(tmp_path / "metadata.parquet")
    assert tuple(table.column_names[:13]) == PUBLISHED_COLUMNS
    assert table.column_names == [*EpisodeSummary.model_fields, SIDE_COLUMN]


def test_rows_are_read_back_as_written(tmp_path: Path) -> None:
    write(tmp_path, 3, 3)
    table = pq.read_table(tmp_path / "metadata.parquet", columns=list(EpisodeSummary.model_fields))
    rows = [EpisodeSummary.model_validate(found) for found in table.to_pylist()]
    assert rows == [row(1), row(2), row(3)]


def test_failed_attempts_keep_their_reasons(tmp_path: Path) -> None:
    write(tmp_path, 1, 3)
    (found,) = pq.read_table(tmp_path / "attempts.parquet").to_pylist()
    assert found["episode_id"] == "ep_000002"
    assert found["reason"] == "timeout"
    assert found["steps"] == 1000
    assert found["at"] == NOW


def test_complete_dataset_has_the_digest_of_its_episodes(tmp_path: Path) -> None:
    meta = write(tmp_path, 3, 3)
    assert meta.complete
    assert meta.dataset_digest == dataset_digest((row(n).episode_id, row(n).content_digest) for n in (3, 1, 2))


def test_unfinished_dataset_has_no_digest(tmp_path: Path) -> None:
    meta = write(tmp_path, 2, 3)
    assert (meta.complete, meta.dataset_digest, meta.episodes, meta.planned) == (False, None, 2, 3)


def test_empty_dataset_can_be_read(tmp_path: Path) -> None:
    write(tmp_path, 0, 3)
    assert pq.read_table(tmp_path / "metadata.parquet").num_rows == 0


def test_the_description_is_read_back_and_keeps_its_creation_time(tmp_path: Path) -> None:
    first = write(tmp_path, 1, 3)
    assert read_dataset_meta(tmp_path) == first
    with open_archive(tmp_path) as archive:
        later = write_tables(archive, small_plan(3), {}, [row(1)], [], NOW + timedelta(days=1))
    assert (later.created_at, later.updated_at) == (NOW, NOW + timedelta(days=1))
    assert later.plan.digest == later.plan_digest


def test_card_has_a_readable_front_matter(tmp_path: Path) -> None:
    write(tmp_path, 2, 3)
    _, front, text = (tmp_path / "README.md").read_text().split("---\n", 2)
    matter = yaml.safe_load(front)
    assert matter["license"] == "cc-by-4.0"
    assert matter["task_categories"] == ["robotics"]
    assert matter["size_categories"] == ["n<1K"]
    whole, failed = ([{"split": "train", "path": name}] for name in ("metadata.parquet", "attempts.parquet"))
    assert matter["configs"] == [
        {"config_name": "default", "default": True, "data_files": whole},
        {"config_name": "metadata", "data_files": whole},
        {"config_name": "attempts", "data_files": failed},
    ]
    assert "2 of 3 planned episodes so far" in text
    assert "pypi.org" not in text  # the package is not on PyPI, so a link would be broken
    assert "| office | 2 | 12.0 | 1.60 |" in text
    assert "| 3 | 67 % |" in text
    assert "| train_id | seen categories, training phrases | 2 | 2 |" in text
    assert "may name the same instances" in text


def test_the_card_describes_verified_instructions_and_varied_light(tmp_path: Path) -> None:
    write(tmp_path / "templates", 1, 1)
    plan = small_plan(1).model_copy(
        update={"language": LanguageSpec(languages=["de", "zh"]), "appearance": Appearance(light=LightRanges())}
    )
    with open_archive(tmp_path / "verified") as archive:
        write_tables(archive, plan, {}, [row(1)], [], NOW)
    before, after = ((tmp_path / name / "README.md").read_text() for name in ("templates", "verified"))
    assert "- en\n" in before
    assert "instruction in English" in before
    assert "30 English templates" in before
    assert "each scene has one light" in before
    assert "- de\n- zh\n" in after
    assert "verifier" in after
    assert "English" not in after
    assert "one light" not in after


def test_the_side_of_an_instance_is_in_row_description_and_card(tmp_path: Path) -> None:
    plan = small_plan(2).model_copy(update={"disjoint_instances": True})
    sides = {"office": {"chair_001": Side.SHARED}}
    with open_archive(tmp_path) as archive:
        write_tables(archive, plan, {}, [row(1), row(2)], [], NOW, sides, {"office": ("chair",)})
    assert pq.read_table(tmp_path / "metadata.parquet")[SIDE_COLUMN].to_pylist() == ["shared", "shared"]
    assert read_dataset_meta(tmp_path).shared_instances == {"office": ("chair",)}
    assert "categories with too few instances (office: chair)" in (tmp_path / "README.md").read_text()


def test_the_gate_result_survives_later_writes(tmp_path: Path) -> None:
    gate = GateOutcome(
        scene="office", expert="proportional", attempts=50, succeeded=30, min_success=0.8, passed=False, reasons={}
    )
    with open_archive(tmp_path) as archive:
        write_tables(archive, small_plan(2), {}, [row(1)], [], NOW, gate=[gate])
        write_tables(archive, small_plan(2), {}, [row(1), row(2)], [], NOW)
    assert read_dataset_meta(tmp_path).gate == (gate,)


def test_directory_without_a_dataset_is_named(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match=r"is not a dataset: dataset_meta.json is missing"):
        read_dataset_meta(tmp_path)


def test_the_error_of_a_newer_format_names_its_number(tmp_path: Path) -> None:
    write(tmp_path, 1, 1)
    path = tmp_path / "dataset_meta.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"format": DATASET_FORMAT + 1, "novelty": True}))
    with pytest.raises(WorldError, match=f"format {DATASET_FORMAT + 1}, this software reads up to {DATASET_FORMAT}: "):
        read_dataset_meta(tmp_path)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 1}', '{"format": "x"}'])
def test_damaged_description_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "dataset_meta.json").write_text(text)
    with pytest.raises(ArchiveCorrupt, match=r"dataset_meta\.json is damaged"):
        read_dataset_meta(tmp_path)


@pytest.mark.parametrize("is_packed", [False, True])
def test_commit_of_a_checkout_is_read(tmp_path: Path, is_packed: bool) -> None:
    git = tmp_path / ".git"
    (git / "refs/heads").mkdir(parents=True)
    (git / "HEAD").write_text("ref: refs/heads/main\n")
    if is_packed:
        (git / "packed-refs").write_text(f"# pack-refs\n{'1' * 40} refs/heads/other\n{'2' * 40} refs/heads/main\n")
    else:
        (git / "refs/heads/main").write_text("2" * 40 + "\n")
    assert git_commit(tmp_path) == "2" * 40


def test_without_a_checkout_there_is_no_commit(tmp_path: Path) -> None:
    assert git_commit(tmp_path) is None
