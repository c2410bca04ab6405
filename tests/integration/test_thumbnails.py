"""Thumbnails of a states dataset, rendered for the viewer of the Hugging Face Hub."""

from __future__ import annotations

import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from coordinator.archive.directory import DirectoryArchive
from coordinator.tables.split_tables import find_faults, write_split_tables
from factory.push.files import lacks_thumbnails, render_thumbnails
from schemas.terms import Recording
from tests.acceptance.factory_cli import Command

pytestmark = pytest.mark.gl


@pytest.fixture
def frames(recordings: dict[Recording, Path]) -> Path:
    return recordings[Recording.FRAMES]


@pytest.fixture
def copied(recordings: dict[Recording, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(recordings[Recording.STATES], tmp_path / "states"))


def thumbnails_of(root: Path) -> list[bytes]:
    (table,) = (root / "data").glob("*.parquet")
    return [None if picture is None else picture["bytes"] for picture in pq.read_table(table)["thumbnail"].to_pylist()]


def test_rendered_thumbnails_equal_those_of_a_frames_dataset(copied: Path, frames: Path) -> None:
    told: list[tuple[int, int]] = []
    assert lacks_thumbnails(copied)
    render_thumbnails(copied, lambda done, of: told.append((done, of)))
    assert sorted(told) == [(1, 2), (2, 2)]
    assert thumbnails_of(copied) == thumbnails_of(frames)
    assert not lacks_thumbnails(copied)
    assert list(find_faults(copied, deep=True)) == []
    (table,) = (copied / "data").glob("*.parquet")
    pq.write_table(pq.read_table(table).replace_schema_metadata(None), table)  # outdated, and therefore written again
    with DirectoryArchive(copied) as archive:
        write_split_tables(archive)
    assert thumbnails_of(copied) == thumbnails_of(frames)


def test_a_push_names_the_option_for_missing_thumbnails(command: Command, copied: Path, frames: Path) -> None:
    notes = []
    for root in (copied, frames):
        notes.append(command("push", root, "someone/nav", "--dry-run").stderr)
    assert "no thumbnails for the Hub's viewer; --thumbnails renders them" in notes[0]
    assert "thumbnails" not in notes[1]
