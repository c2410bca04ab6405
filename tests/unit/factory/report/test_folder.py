"""The output folder of a report must be empty or have an earlier report; other files are never deleted."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.report.make import MARKER_FILE, PAGE_FILE, Summary, require_usable, write_files
from schemas.errors import UsageError, WorldError


def summary(*files: str) -> Summary:
    return Summary(
        run="test-00000000",
        plan_digest="a" * 64,
        dataset_digest=None,
        episodes=0,
        planned=1,
        complete=False,
        remarks=(),
        comparisons=(),
        files=files,
    )


def write(out: Path, *files: str) -> None:
    write_files(out, {name: name.encode() for name in files}, summary(*files))


def test_a_missing_or_empty_folder_is_accepted(tmp_path: Path) -> None:
    require_usable(tmp_path / "new", force=False)
    require_usable(tmp_path, force=False)


def test_a_folder_with_other_files_is_refused_unless_forced(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match="--force"):
        require_usable(tmp_path, force=False)
    require_usable(tmp_path, force=True)
    write(tmp_path, PAGE_FILE)
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_a_foreign_report_json_does_not_mark_a_report_folder(tmp_path: Path) -> None:
    (tmp_path / MARKER_FILE).write_text('{"title": "quarterly"}')
    with pytest.raises(UsageError, match="not a report"):
        require_usable(tmp_path, force=False)


def test_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "page").write_text("mine")
    with pytest.raises(UsageError, match="is a file"):
        require_usable(tmp_path / "page", force=True)


def test_a_folder_within_a_dataset_is_refused(tmp_path: Path) -> None:
    (tmp_path / "dataset_meta.json").write_text("{}")
    with pytest.raises(UsageError, match="is inside a dataset"):
        require_usable(tmp_path / "report", force=True)


def test_a_new_report_replaces_the_old_one_and_removes_its_leftovers(tmp_path: Path) -> None:
    write(tmp_path, PAGE_FILE, "figures/old.svg")
    (tmp_path / "figures" / "mine.svg").write_text("mine")
    require_usable(tmp_path, force=False)
    write(tmp_path, PAGE_FILE, "figures/new.svg")
    names = {path.name for path in tmp_path.rglob("*") if path.is_file()}
    assert names == {"mine.svg", "new.svg", MARKER_FILE, PAGE_FILE}


def test_an_edited_marker_does_not_cause_the_deletion_of_other_files(tmp_path: Path) -> None:
    out, other = tmp_path / "out", tmp_path / "other.svg"
    write(out, PAGE_FILE)
    other.write_text("mine")
    names = ("../other.svg", "figures/../../other.svg", str(other), "mine.txt")
    (out / "mine.txt").write_text("mine")
    (out / MARKER_FILE).write_text(summary(*names).model_dump_json())
    write(out, PAGE_FILE)
    assert other.exists()
    assert (out / "mine.txt").exists()


def test_a_folder_that_cannot_be_created_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WorldError, match="cannot write the report"):
        write(tmp_path / "file" / "out", PAGE_FILE)
