"""A packed states dataset: packing by ranges of the ledger, verification, repair and reading."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from coordinator.archive.opening import open_archive
from coordinator.gateway.gather import gather
from coordinator.ledger.archived import record_at_gateway
from coordinator.protocol.protocol import Terms
from coordinator.recovery.reconcile import reconcile
from coordinator.recovery.repair_dataset import RepairReport, repair
from coordinator.validation.validator import Validator
from factory.cli.main import cli
from factory.dataset.reader import Dataset
from factory.push.files import plan_push
from factory.stats.rows import read_rows
from factory.verify.dataset import Kind, verify
from schemas.errors import UsageError
from schemas.storage.dataset_files import LEDGER_FILE
from schemas.storage.episode_list import list_episodes
from schemas.storage.packed_path import PackedPath
from schemas.storage.shard_index import read_index
from schemas.terms import Recording
from tests.builders.archived import ArchivedRun
from tests.builders.ledger import TTL_S

EPISODES, SIZE = 5, 2


@pytest.fixture(scope="module")
def validator() -> Iterator[Validator]:
    with Validator() as checking:
        yield checking


@pytest.fixture
def run(tmp_path: Path) -> ArchivedRun:
    """A finished run of states whose episodes are not packed yet."""
    return ArchivedRun(tmp_path / "out", EPISODES, EPISODES, record=Recording.STATES)


@pytest.fixture
def packed(run: ArchivedRun) -> ArchivedRun:
    assert run.pack(SIZE) == EPISODES
    return run


def shard_with(run: ArchivedRun, index: int) -> PackedPath:
    path = list_episodes(run.root).episodes[index]
    assert isinstance(path, PackedPath)
    return path


def flip(path: PackedPath) -> None:
    """Flips a bit of a packed episode on the disk."""
    assert isinstance(path.shard, Path)
    data = bytearray(path.shard.read_bytes())
    data[path.offset + path.size // 2] ^= 1
    path.shard.write_bytes(data)


def mend(run: ArchivedRun, validator: Validator) -> RepairReport:
    foreseen = repair(run.repair_input(), validator, run.timed_ledger.now, apply=False)
    report = repair(run.repair_input(), validator, run.timed_ledger.now, apply=True)
    assert [(action.kind, action.what) for action in foreseen.actions] == [
        (action.kind, action.what) for action in report.actions
    ]
    assert repair(run.repair_input(), validator, run.timed_ledger.now, apply=False).is_sound
    return report


def findings(root: Path, *, deep: bool = False) -> list[tuple[Kind, str]]:
    """Returns the findings except those on the scene, whose package is not valid."""
    found = verify(root, deep).findings
    return [(finding.kind, finding.file) for finding in found if not finding.file.startswith("scenes/")]


def test_only_ranges_without_unfinished_jobs_are_packed_during_a_run(tmp_path: Path) -> None:
    run = ArchivedRun(tmp_path / "out", planned=6, done=5, record=Recording.STATES)
    assert run.pack(SIZE, is_over=False) == 4
    assert run.file(5).is_file()
    assert run.pack(SIZE, is_over=False) == 0
    assert len(after_names(run)) == 3
    with open_archive(run.root) as archive:
        run.archive_episode(archive, 6)
    assert run.pack(SIZE) == 2
    assert len(after_names(run)) == 3
    assert findings(run.root) == []


def test_recordings_of_frames_and_datasets_of_one_range_are_not_packed(tmp_path: Path, run: ArchivedRun) -> None:
    assert run.pack(EPISODES) == 0
    assert ArchivedRun(tmp_path / "frames", 3, 3).pack(SIZE) == 0


def test_a_packed_dataset_is_valid_and_has_the_content_of_the_unpacked_dataset(
    run: ArchivedRun, validator: Validator
) -> None:
    before = Dataset(run.root)
    poses = [episode.poses for episode in before]
    opened_later = list(Dataset(run.root))
    assert run.pack(SIZE) == EPISODES
    after = Dataset(run.root)
    assert after.digest == before.digest
    for episode, late, expected in zip(after, opened_later, poses, strict=True):
        assert np.array_equal(episode.poses, expected)
        assert isinstance(episode.path, PackedPath)
        assert np.array_equal(late.poses, expected)
    assert findings(run.root, deep=True) == []
    assert repair(run.repair_input(), validator, run.timed_ledger.now, apply=True).is_sound
    assert [row.index for row in read_rows(run.root).episodes] == [1, 2, 3, 4, 5]
    assert ", 3 in total" in (run.root / "README.md").read_text(encoding="utf-8")
    pushed = {file.name for file in plan_push(run.root, "manifest.json").files}
    assert {"shards.parquet", *(f"episodes/{name}" for name in after_names(run))} <= pushed


def after_names(run: ArchivedRun) -> list[str]:
    return [path.name for path in (run.root / "episodes").iterdir()]


def test_a_flipped_bit_is_found_and_only_its_episode_is_queued_again(packed: ArchivedRun, validator: Validator) -> None:
    flip(shard_with(packed, 3))
    assert findings(packed.root) == [(Kind.CHANGED, "episodes/ep_000003.zip")]
    report = mend(packed, validator)
    assert {(str(action.kind), action.what.rpartition("/")[2]) for action in report.actions} == {
        ("quarantine", "ep_000003.zip"),
        ("requeue", "ep_000003"),
        ("rewrite", "metadata.parquet"),
    }
    assert packed.states()[3] == "pending"
    assert list(list_episodes(packed.root).episodes) == [1, 2, 4, 5]
    assert findings(packed.root) == []


def test_a_truncated_shard_loses_only_the_episodes_that_are_cut(packed: ArchivedRun, validator: Validator) -> None:
    last = shard_with(packed, 4)
    assert isinstance(last.shard, Path)
    last.shard.write_bytes(last.shard.read_bytes()[: last.offset + 10])
    assert {kind for kind, _ in findings(packed.root)} == {Kind.DAMAGED, Kind.MISSING, Kind.CONTRADICTION}
    report = mend(packed, validator)
    assert ("requeue", "ep_000004") in {(str(action.kind), action.what) for action in report.actions}
    assert list(list_episodes(packed.root).episodes) == [1, 2, 3, 5]
    assert packed.states()[3] == "archived"


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: path.write_bytes(b"no table")])
def test_a_missing_or_damaged_index_is_reported_and_rewritten(packed: ArchivedRun, validator: Validator, harm) -> None:  # type: ignore[no-untyped-def]
    harm(packed.root / "shards.parquet")
    assert len([episode.poses for episode in Dataset(packed.root)]) == EPISODES
    assert findings(packed.root) == [(Kind.CONTRADICTION, "shards.parquet")]
    assert [action.what for action in mend(packed, validator).actions] == ["shards.parquet"]
    stored = read_index(packed.root)
    assert stored is not None
    assert len(stored) == EPISODES


def test_files_of_packed_episodes_are_reported_and_removed(packed: ArchivedRun, validator: Validator) -> None:
    path = shard_with(packed, 2)
    packed.file(2).write_bytes(path.read_bytes())
    assert findings(packed.root) == [(Kind.SURPLUS, "episodes")]
    assert [action.what for action in mend(packed, validator).actions] == ["episodes"]
    assert not packed.file(2).exists()


def test_a_lost_ledger_is_rebuilt_from_shards(packed: ArchivedRun, validator: Validator) -> None:
    (packed.root / LEDGER_FILE).unlink()
    report = mend(packed, validator)
    assert [str(action.kind) for action in report.actions].count("adopt") == EPISODES
    assert set(packed.states().values()) == {"archived"}
    assert len(after_names(packed)) == 3


def test_a_start_finds_a_lost_shard_and_queues_its_episodes(packed: ArchivedRun, validator: Validator) -> None:
    lost = shard_with(packed, 1)
    assert isinstance(lost.shard, Path)
    lost.shard.unlink()
    terms = Terms(packed.plan, packed.catalog, "test", TTL_S, 1.0)
    with open_archive(packed.root) as archive:
        result = reconcile(archive, packed.timed_ledger.engine, terms, validator, packed.timed_ledger.now)
    packed.timed_ledger.engine.dispose()
    assert (result.requeued, result.adopted, result.quarantined) == ([1, 2], [], [])


@pytest.mark.parametrize("is_packed", [False, True])
def test_gather_packs_what_it_copies_from_files_and_from_shards(run: ArchivedRun, is_packed: bool) -> None:
    source, digests = run.root.with_name("gw1"), run.digests()
    shutil.move(run.root / "episodes", source / "episodes")
    if is_packed:
        with open_archive(source) as archive:
            archive.pack(digests, 1, 10)
    with run.timed_ledger.engine.begin() as connection:
        for index in digests:
            record_at_gateway(connection, index, "gw1")
    run.timed_ledger.engine.dispose()
    for gathered in (EPISODES, 0):
        report = gather(run.repair_input(), [source], run.timed_ledger.now, shard_episodes=SIZE)
        assert (report.gathered, report.missing, report.episodes) == (gathered, (), EPISODES)
    assert len(after_names(run)) == 3
    assert findings(run.root) == []


def test_the_command_packs_an_existing_dataset(run: ArchivedRun, capsys: pytest.CaptureFixture[str]) -> None:
    poses = [episode.poses for episode in Dataset(run.root)]
    shutil.copytree(run.root, run.root.with_name("without ledger"), ignore=shutil.ignore_patterns("ledger*"))
    for root in (run.root, run.root.with_name("without ledger")):
        for packed_now in (EPISODES, 0):  # the second call has nothing to do
            cli.main(["pack", str(root), "--json"], standalone_mode=False)
            assert json.loads(capsys.readouterr().out) == {
                "dataset": str(root),
                "packed": packed_now,
                "shards": 1,
                "files": 0,
            }
        assert findings(root) == []
        assert ", 1 in total" in (root / "README.md").read_text(encoding="utf-8")
        assert all(np.array_equal(one.poses, two) for one, two in zip(Dataset(root), poses, strict=True))
    cli.main(["status", str(run.root), "--json"], standalone_mode=False)
    assert json.loads(capsys.readouterr().out)["shards"] == 1


def test_the_command_refuses_a_recording_of_frames(tmp_path: Path) -> None:
    run = ArchivedRun(tmp_path / "frames", 1, 1)
    with pytest.raises(UsageError, match="stores frames"):
        cli.main(["pack", str(run.root)], standalone_mode=False)
    assert run.file(1).is_file()
