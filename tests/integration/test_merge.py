"""Merged datasets: bytes, numbers, provenance, interruptions, refusals, and the commands that read them."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from factory.dataset.reader import Dataset
from factory.export.origin import find_origin
from factory.merge.merge import merge, open_parts
from factory.verify.dataset import verify
from schemas.dataset.meta import FORMAT_WITH_SOURCES, read_dataset_meta
from schemas.errors import ArchiveCorrupt, UsageError, WorldError
from schemas.storage.dataset_files import SOURCES_FILE
from schemas.terms import Recording
from tests.acceptance.factory_cli import Command
from tests.builders.dataset import NOW, make_dataset
from tests.builders.driven import driven_recordings, make_driven
from tests.builders.plan import small_plan
from tests.builders.shared import build_once


def made(root: Path, seed: int, episodes: int = 3, **changes: object) -> Path:
    make_dataset(root, episodes, plan=small_plan(episodes).model_copy(update={"seed": seed, **changes}))
    return root


def digests(root: Path) -> list[str]:
    return [hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted((root / "episodes").glob("*.zip"))]


@pytest.fixture
def two(tmp_path: Path) -> tuple[Path, Path]:
    return made(tmp_path / "a", 1, 3), made(tmp_path / "b", 2, 2)


def test_episodes_keep_their_bytes_and_rows_name_their_origin(two: tuple[Path, Path], tmp_path: Path) -> None:
    report = merge(open_parts(two, is_partial=False), tmp_path / "c", NOW)
    assert digests(tmp_path / "c") == [*digests(two[0]), *digests(two[1])]
    data = Dataset(tmp_path / "c")
    assert data.column("episode_id").to_pylist() == [f"ep_{n:06d}" for n in range(1, 6)]
    assert (data.meta.format, data.meta.complete, data.meta.planned) == (FORMAT_WITH_SOURCES, True, 5)
    assert data.meta.dataset_digest == data.digest == report.digest
    rows = pq.read_table(tmp_path / "c" / "metadata.parquet").to_pylist()
    assert [(row["source"], row["source_episode"]) for row in rows] == [
        *(("a", f"ep_{n:06d}") for n in (1, 2, 3)),
        *(("b", f"ep_{n:06d}") for n in (1, 2)),
    ]
    plans = [read_dataset_meta(root).plan for root in two]
    assert [row["plan_digest"] for row in rows] == [plans[0].digest] * 3 + [plans[1].digest] * 2
    assert [(each.name, each.first, each.episodes) for each in data.meta.sources] == [("a", 1, 3), ("b", 4, 2)]
    attempts = pq.read_table(tmp_path / "c" / "attempts.parquet")["episode_id"].to_pylist()
    assert attempts == ["ep_000001", "ep_000004"]
    assert len(data.filter(episode="ep_000005")) == 1
    assert verify(tmp_path / "c").ok


def test_a_merged_dataset_can_be_merged_again(two: tuple[Path, Path], tmp_path: Path) -> None:
    merge(open_parts(two, is_partial=False), tmp_path / "c", NOW)
    merge(open_parts((made(tmp_path / "d", 3, 1), tmp_path / "c"), is_partial=False), tmp_path / "e", NOW)
    meta = read_dataset_meta(tmp_path / "e")
    assert [(each.name, each.first) for each in meta.sources] == [("d", 1), ("c/a", 2), ("c/b", 5)]
    assert [meta.own_index(index) for index in range(1, 7)] == [1, 1, 2, 3, 1, 2]
    assert digests(tmp_path / "e") == [*digests(tmp_path / "d"), *digests(two[0]), *digests(two[1])]
    assert verify(tmp_path / "e").ok


def test_hard_links_share_the_bytes(two: tuple[Path, Path], tmp_path: Path) -> None:
    merge(open_parts(two, is_partial=False), tmp_path / "c", NOW, is_linked=True)
    assert (tmp_path / "c/episodes/ep_000004.zip").samefile(two[1] / "episodes/ep_000001.zip")
    assert verify(tmp_path / "c").ok


def test_an_interrupted_merge_shows_no_dataset_and_the_same_call_continues_it(
    two: tuple[Path, Path], tmp_path: Path
) -> None:
    merge(open_parts(two, is_partial=False), tmp_path / "reference", NOW)

    def stop(done: int, _all: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        merge(open_parts(two, is_partial=False), tmp_path / "c", NOW, on_progress=stop)
    assert not (tmp_path / "c").exists()
    work = tmp_path / ".c.merging"
    kept = {path.name: path.stat().st_ino for path in (work / "episodes").iterdir()}
    assert len(kept) == 2
    merge(open_parts(two, is_partial=False), tmp_path / "c", NOW)
    assert not work.exists()
    assert {name: (tmp_path / "c/episodes" / name).stat().st_ino for name in kept} == kept
    assert Dataset(tmp_path / "c").digest == Dataset(tmp_path / "reference").digest
    assert not (tmp_path / "c/.merge.json").exists()


def test_leftovers_of_another_merge_are_not_used(two: tuple[Path, Path], tmp_path: Path) -> None:
    def stop(done: int, _all: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        merge(open_parts(two, is_partial=False), tmp_path / "c", NOW, on_progress=stop)
    merge(open_parts(two[::-1], is_partial=False), tmp_path / "c", NOW)
    assert digests(tmp_path / "c") == [*digests(two[1]), *digests(two[0])]


def test_a_damaged_episode_of_a_source_stops_the_merge(two: tuple[Path, Path], tmp_path: Path) -> None:
    file = two[1] / "episodes/ep_000001.zip"
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    with pytest.raises(ArchiveCorrupt, match=re.escape(f"repair the dataset with `factory repair {two[1]}`")):
        merge(open_parts(two, is_partial=False), tmp_path / "c", NOW)
    file.unlink()
    with pytest.raises(ArchiveCorrupt, match="lacks ep_000001, which its tables list"):
        merge(open_parts(two, is_partial=False), tmp_path / "c", NOW)
    assert not (tmp_path / "c").exists()


def test_sources_that_cannot_be_merged_are_refused_with_the_remedy(two: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="are the same dataset: give it once"):
        open_parts((two[0], tmp_path / "." / "a"), is_partial=False)
    with pytest.raises(WorldError, match=r"is not a dataset: dataset_meta\.json is missing"):
        open_parts((two[0], tmp_path / "nothing"), is_partial=False)
    shutil.copytree(two[0], tmp_path / "copy")
    with pytest.raises(UsageError, match=r"3 of 3 episodes of copy are also in a \(equal content digests\)"):
        open_parts((two[0], tmp_path / "copy"), is_partial=False)
    make_dataset(tmp_path / "short", 1, plan=small_plan(2).model_copy(update={"seed": 9}))
    with pytest.raises(
        UsageError, match=r"has 1 of 2 planned episodes: finish it with .* merge what it has with --par"
    ):
        open_parts((two[0], tmp_path / "short"), is_partial=False)
    with pytest.raises(UsageError, match="exists and is not empty"):
        merge(open_parts(two, is_partial=False), two[0], NOW)
    with pytest.raises(UsageError, match=f"is inside the dataset {two[0]}"):
        merge(open_parts(two, is_partial=False), two[0] / "c", NOW)
    changed = json.loads((two[1] / "dataset_meta.json").read_text())
    changed["scenes"]["office"] = "0" * 64
    (two[1] / "dataset_meta.json").write_text(json.dumps(changed))
    with pytest.raises(UsageError, match="a and b have different packages of scene office"):
        open_parts(two, is_partial=False)


def test_a_partial_source_leaves_gaps_in_the_numbers(two: tuple[Path, Path], tmp_path: Path) -> None:
    make_dataset(tmp_path / "short", 1, plan=small_plan(2).model_copy(update={"seed": 9}))
    report = merge(open_parts((tmp_path / "short", two[1]), is_partial=True), tmp_path / "c", NOW)
    assert (report.episodes, report.planned, report.digest) == (3, 4, None)
    assert Dataset(tmp_path / "c").column("index").to_pylist() == [1, 3, 4]
    assert verify(tmp_path / "c").ok


def test_the_disk_is_checked_before_anything_is_copied(
    two: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage._replace(free=1000))
    with pytest.raises(WorldError, match=r"has 1 kB free, but the episodes need .* or make hard links with --link"):
        merge(open_parts(two, is_partial=False), tmp_path / "c", NOW)
    assert not (tmp_path / "c").exists()


@pytest.fixture
def drives(shared: Path) -> tuple[Path, Path]:
    """Two datasets of states with different seeds, two drives each; tests only read them."""

    def drive(root: Path) -> None:
        make_driven(root, Recording.STATES, seed=5)

    return driven_recordings(shared)[Recording.STATES], build_once(shared / "driven-5", drive)


@pytest.mark.gl
def test_commands_read_a_merged_dataset(command: Command, drives: tuple[Path, Path], tmp_path: Path) -> None:
    root = tmp_path / "c"
    report = command.json("merge", *drives, "-o", root)
    assert (report["episodes"], report["planned"], report["linked"]) == (4, 4, False)
    assert command.json("verify", root, "--deep", "--render", "all")["ok"]
    assert command.json("replay", root, 4)["identical"]
    assert command.json("stats", root)["episodes"] == 4
    assert command.json("show", root, 4, "-o", tmp_path / "sheet.png")["episode"] == "ep_000004"
    assert command("run", "--out", root, expect=2).stderr.startswith(f"error: {root} was merged from 2 runs")
    assert "was merged from 2 runs and has no ledger" in command("status", root, expect=1).stderr
    assert "render the source datasets before" in command("render", root, "-o", tmp_path / "r", expect=2).stderr


@pytest.mark.gl
def test_a_dataset_of_states_and_one_of_frames_are_refused(shared: Path, tmp_path: Path) -> None:
    places = [driven_recordings(shared)[record] for record in Recording]
    with pytest.raises(UsageError, match="render the frames of driven-states with `factory render"):
        merge(open_parts(places, is_partial=False), tmp_path / "c", NOW)


@pytest.mark.gl
def test_repair_simulates_missing_episodes_again_and_rebuilds_lost_tables(
    command: Command, drives: tuple[Path, Path], tmp_path: Path
) -> None:
    root = tmp_path / "c"
    merge(open_parts(drives, is_partial=False), root, NOW)
    assert command.json("repair", root, "--dry-run")["actions"] == []
    digest, intact = Dataset(root).digest, (root / "episodes/ep_000001.zip").read_bytes()
    (root / "episodes/ep_000004.zip").unlink()
    (root / "episodes/ep_000001.zip").write_bytes(b"nothing")
    dry = command.json("repair", root, "--dry-run", expect=1)
    assert sorted(action["kind"] for action in dry["actions"]) == ["quarantine", "requeue", "requeue", "rewrite"]
    assert dry["episodes"] == 2
    (root / "episodes/ep_000001.zip").write_bytes(intact)
    fixed = command.json("repair", root)
    assert [action["what"] for action in fixed["actions"]] == ["ep_000004", "metadata.parquet"]
    assert (fixed["episodes"], fixed["planned"]) == (4, 4)
    assert verify(root, deep=True).ok
    assert Dataset(root).digest == digest
    (root / "dataset_meta.json").write_text("{")
    (root / "metadata.parquet").write_bytes(b"")
    assert (root / SOURCES_FILE).is_file()
    repaired = command.json("repair", root)
    assert [action["kind"] for action in repaired["actions"]].count("adopt") == 4
    assert verify(root, deep=True).ok
    assert Dataset(root).digest == digest


@pytest.mark.gl
def test_repair_sets_files_of_other_runs_aside(command: Command, drives: tuple[Path, Path], tmp_path: Path) -> None:
    root = tmp_path / "c"
    merge(open_parts(drives, is_partial=False), root, NOW)
    (root / "episodes/ep_000009.zip").write_bytes((root / "episodes/ep_000001.zip").read_bytes())
    (action, _) = command.json("repair", root)["actions"]
    assert (action["kind"], action["what"]) == ("quarantine", "episodes/ep_000009.zip")
    assert "which is not this episode of a source" in action["why"]
    assert verify(root).ok


@pytest.mark.gl
@pytest.mark.parametrize("name", ["lerobot", "mcap", "vlnce", "paper", "webdataset"])
def test_exports_of_a_merged_dataset_name_its_numbers_and_can_be_replayed(
    command: Command, drives: tuple[Path, Path], tmp_path: Path, name: str
) -> None:
    merge(open_parts(drives, is_partial=False), tmp_path / "c", NOW)
    command("export", tmp_path / "c", "--episode", "4", "--to", name, "-o", tmp_path / "out")
    replayed = command.json("replay", "--from", tmp_path / "out", 4, "--scenes", drives[0] / "scenes")
    assert (replayed["episode_id"], replayed["identical"]) == ("ep_000004", True)
    origin = find_origin(tmp_path / "out", "4")
    assert (origin.job.index, origin.job.root_seed) == (2, 5)
    assert origin.states_digest == Dataset(drives[1])["ep_000002"].states_digest
