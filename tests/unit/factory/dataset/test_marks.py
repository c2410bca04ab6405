"""Flags and notes are stored atomically beside the dataset and exclude episodes from exports."""

from __future__ import annotations

import pytest

from factory.dataset.marks import Mark, Marks, excluded_in, read_marks
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.export.execution.selection import select
from schemas.errors import UsageError, WorldError
from schemas.storage.dataset_files import MARKS_FILE, is_part
from tests.builders.dataset import make_dataset


def test_flags_and_notes_are_read_as_they_were_written(tmp_path):
    marks = Marks(site_of(str(tmp_path)))
    assert marks.read() == {}
    marks.write("ep_000002", Mark(flagged=True, note='blurred „Übung" 🤖 <b>'))
    marks.write("ep_000001", Mark(note="check"))
    assert marks.read() == {
        "ep_000001": Mark(note="check"),
        "ep_000002": Mark(flagged=True, note='blurred „Übung" 🤖 <b>'),
    }
    assert excluded_in(tmp_path / MARKS_FILE) == ["ep_000002"]


def test_an_episode_without_flag_and_note_is_removed_from_the_file(tmp_path):
    marks = Marks(site_of(str(tmp_path)))
    marks.write("ep_000001", Mark(flagged=True))
    marks.write("ep_000001", Mark())
    assert marks.read() == {}


def test_a_damaged_file_is_an_error_and_is_not_replaced(tmp_path):
    path = tmp_path / MARKS_FILE
    path.write_text('{"marks": {"ep_000001": ')
    with pytest.raises(WorldError, match="restore or delete"):
        Marks(site_of(str(tmp_path))).write("ep_000002", Mark(flagged=True))
    assert path.read_text() == '{"marks": {"ep_000001": '
    with pytest.raises(WorldError):
        read_marks(path)


def test_excluded_episodes_are_omitted_from_a_selection(tmp_path):
    make_dataset(tmp_path / "data", 3)
    dataset = Dataset(tmp_path / "data")
    Marks(site_of(str(tmp_path / "data"))).write("ep_000002", Mark(flagged=True))
    kept = select(dataset, excluded=excluded_in(tmp_path / "data" / MARKS_FILE))
    assert kept.column("episode_id").to_pylist() == ["ep_000001", "ep_000003"]
    listed = tmp_path / "list.txt"
    listed.write_text("ep_000001\n\n ep_000003 \n")
    assert select(dataset, excluded=excluded_in(listed)).column("episode_id").to_pylist() == ["ep_000002"]
    listed.write_text("ep_000001\nep_000002\nep_000003\n")
    with pytest.raises(UsageError, match="no episodes"):
        select(dataset, excluded=excluded_in(listed))


def test_a_missing_list_is_an_error(tmp_path):
    with pytest.raises(WorldError, match="does not exist"):
        excluded_in(tmp_path / "none.json")


def test_the_file_is_part_of_a_dataset():
    assert is_part(MARKS_FILE)
