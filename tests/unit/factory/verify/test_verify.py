"""Verification finds every kind of damage and reports no false damage."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from coordinator.archive.opening import open_archive
from coordinator.tables.split_tables import write_split_tables
from coordinator.tables.write import write_tables
from factory.dataset.reader import Dataset
from factory.verify.dataset import Kind, VerifyReport, verify
from factory.verify.findings import print_report
from schemas.dataset.rows import EpisodeSummary
from schemas.errors import WorldError
from tests.builders.bundle import job_for, parts_for
from tests.builders.dataset import NOW, archive_episode, make_dataset

EPISODE = "episodes/ep_000002.zip"


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("pristine") / "data"
    make_dataset(root, 3)
    return root


@pytest.fixture
def data(pristine: Path, tmp_path: Path) -> Path:
    """A copy of the dataset that the test may change."""
    return Path(shutil.copytree(pristine, tmp_path / "data"))


def kinds(report: VerifyReport) -> list[tuple[Kind, str]]:
    return sorted({(finding.kind, finding.file) for finding in report.findings})


def edit_meta(root: Path, **changes: object) -> None:
    path = root / "dataset_meta.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def edit_row(root: Path, position: int, **changes: object) -> None:
    table = pq.read_table(root / "metadata.parquet")
    rows = table.to_pylist()
    rows[position] |= changes
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), root / "metadata.parquet")


@pytest.mark.parametrize("deep", [False, True])
def test_whole_dataset_has_no_findings(pristine: Path, deep: bool) -> None:
    seen: list[tuple[int, int]] = []
    report = verify(pristine, deep, lambda done, total: seen.append((done, total)))
    assert report.findings == []
    assert report.ok
    assert (report.episodes, report.complete, report.digest) == (3, True, Dataset(pristine).digest)
    assert seen == [(1, 3), (2, 3), (3, 3)]


def test_several_processes_report_the_findings_of_one_process(data: Path) -> None:
    with (data / EPISODE).open("ab") as file:
        file.write(b"x")
    edit_row(data, 2, final_ne_m=0.5)
    assert verify(data, deep=True, processes=2).findings == verify(data, deep=True).findings


def test_unfinished_dataset_is_sound(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 2, planned=5)
    report = verify(tmp_path / "data", deep=True)
    assert report.findings == []
    assert not report.complete


def test_missing_episode_is_found(data: Path) -> None:
    (data / EPISODE).unlink()
    assert kinds(verify(data)) == [(Kind.MISSING, EPISODE)]


@pytest.mark.parametrize("length", [0, 1, 1000, -1])
def test_truncated_episode_is_found(data: Path, length: int) -> None:
    (data / EPISODE).write_bytes((data / EPISODE).read_bytes()[:length])
    assert kinds(verify(data)) == [(Kind.TRUNCATED, EPISODE)]
    assert (Kind.INVALID, EPISODE) in kinds(verify(data, deep=True))


def test_appended_bytes_are_found(data: Path) -> None:
    with (data / EPISODE).open("ab") as file:
        file.write(b"x")
    assert (Kind.TRUNCATED, EPISODE) in kinds(verify(data))


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_every_flipped_bit_is_found(data: Path, place: float, bit: int) -> None:
    path = data / EPISODE
    good = path.read_bytes()
    bad = bytearray(good)
    bad[int(place * len(bad))] ^= 1 << bit
    path.write_bytes(bad)
    try:
        assert kinds(verify(data)) == [(Kind.CHANGED, EPISODE)]
    finally:
        path.write_bytes(good)


def test_surplus_and_foreign_files_are_distinguished(data: Path) -> None:
    shutil.copy(data / EPISODE, data / "episodes/ep_000099.zip")
    (data / "episodes/notes.txt").write_text("mine")
    (data / "scenes/old-0000000000000000.scene.zip").write_bytes(b"")
    (data / "movie.mp4").write_bytes(b"")
    assert kinds(verify(data)) == [
        (Kind.FOREIGN, "episodes/notes.txt"),
        (Kind.FOREIGN, "movie.mp4"),
        (Kind.FOREIGN, "scenes/old-0000000000000000.scene.zip"),
        (Kind.SURPLUS, "episodes/ep_000099.zip"),
    ]


def test_files_of_the_coordinator_are_not_foreign(data: Path) -> None:
    for name in ("ledger.db", "ledger.db-wal", ".lock", ".coordinator.json"):
        (data / name).write_bytes(b"")
    assert verify(data).ok


def test_swapped_episodes_are_found(data: Path) -> None:
    one, two = data / "episodes/ep_000001.zip", data / EPISODE
    one.write_bytes(two.read_bytes())
    found = kinds(verify(data, deep=True))
    assert {kind for kind, file in found if file == "episodes/ep_000001.zip"} & {Kind.CHANGED, Kind.TRUNCATED}
    assert (Kind.CONTRADICTION, "episodes/ep_000001.zip") in found


@pytest.mark.parametrize(
    ("name", "damage", "kind"),
    [
        ("attempts.parquet", None, Kind.MISSING),
        ("attempts.parquet", b"rubbish", Kind.DAMAGED),
        ("README.md", None, Kind.MISSING),
    ],
)
def test_damaged_table_is_found(data: Path, name: str, damage: bytes | None, kind: Kind) -> None:
    if damage is None:
        (data / name).unlink()
    else:
        (data / name).write_bytes(damage)
    assert kinds(verify(data)) == [(kind, name)]


def test_unreadable_metadata_is_one_finding_and_no_digest_is_printed(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (data / "metadata.parquet").write_bytes(b"PAR1")
    report = verify(data)
    (finding,) = report.findings
    assert finding.kind is Kind.DAMAGED
    assert "metadata.parquet is damaged" in finding.text
    print_report(report)
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.endswith("the tables cannot be read, so the number of episodes and the digest are unknown")
    assert "None" not in last


def test_missing_or_changed_scene_is_found(data: Path) -> None:
    (package,) = (data / "scenes").iterdir()
    good = package.read_bytes()
    package.unlink()
    assert kinds(verify(data)) == [(Kind.MISSING, f"scenes/{package.name}")]
    package.write_bytes(good[:-1])
    assert kinds(verify(data)) == [(Kind.DAMAGED, f"scenes/{package.name}")]
    comment = bytearray(good)
    comment[12] ^= 1  # the time of the first member, which no decoder reads
    package.write_bytes(comment)
    assert kinds(verify(data)) == [(Kind.CHANGED, f"scenes/{package.name}")]


def test_forged_description_is_found(data: Path) -> None:
    edit_meta(data, dataset_digest="0" * 64, episodes=4, failed_attempts=7, plan_digest="1" * 64)
    texts = "\n".join(finding.text for finding in verify(data).findings)
    for text in (
        "dataset digest 0000",
        "4 episodes, metadata.parquet has 3",
        "1 rows, but dataset_meta",
        "plan digest 1111",
    ):
        assert text in texts


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"final_ne_m": 0.5}, "final_ne_m: metadata.parquet has 0.5, the episode has 1.5775"),
        ({"instruction": "Fly."}, "instruction: metadata.parquet has Fly., the episode has Go to"),
        ({"content_digest": "0" * 32}, "content_digest: metadata.parquet has"),
        ({"split": "val_id"}, "split: metadata.parquet has val_id, the episode has train_id"),
        ({"renderer": "other"}, "renderer: metadata.parquet has other"),
    ],
)
def test_row_that_differs_from_its_episode_is_found(data: Path, changes: dict[str, object], text: str) -> None:
    edit_row(data, 1, **changes)
    assert any(text in finding.text for finding in verify(data, deep=True).findings)


def test_a_duplicate_row_is_found(data: Path) -> None:
    edit_row(data, 1, episode_id="ep_000001", index=1)
    assert (Kind.CONTRADICTION, "metadata.parquet") in kinds(verify(data))


def test_row_that_violates_its_model_is_found(data: Path) -> None:
    edit_row(data, 1, split="someday")
    assert (Kind.DAMAGED, "metadata.parquet") in kinds(verify(data))


def test_episode_with_consistent_hashes_but_impossible_motion_is_found(data: Path) -> None:
    """The episode and the tables are changed consistently, but the motion violates the kinematic limits."""
    before = Dataset(data)
    with open_archive(data) as archive:
        first = before[0]
        poses = first.poses.copy()
        poses[6:, 0] += 0.02
        forged = parts_for(first.meta.job).with_arrays(poses=poses).measured()
        archive.unpublish(1)
        rows: list[EpisodeSummary] = [archive_episode(archive, forged), before[1].summary, before[2].summary]
        write_tables(archive, before.meta.plan, before.meta.scenes, rows, [], NOW)
        write_split_tables(archive)
    assert verify(data).ok
    (finding,) = verify(data, deep=True).findings
    assert (finding.kind, finding.file) == (Kind.INVALID, "episodes/ep_000001.zip")
    assert "displacement in a step beyond the command" in finding.text


def test_target_whose_position_differs_from_the_scene_is_found(data: Path) -> None:
    before = Dataset(data)
    with open_archive(data) as archive:
        moved = parts_for(before[0].meta.job).with_meta(target_centroid_m=(1.59, 0.0, 0.5)).measured()
        archive.unpublish(1)
        rows = [archive_episode(archive, moved), before[1].summary, before[2].summary]
        write_tables(archive, before.meta.plan, before.meta.scenes, rows, [], NOW)
    assert any("is 0.010000 m away from the scene's" in finding.text for finding in verify(data, deep=True).findings)


def test_quota_of_the_plan_is_compared(data: Path) -> None:
    before = Dataset(data)
    with open_archive(data) as archive:
        job = before[2].meta.job
        other = job_for(
            4, **{name: getattr(job, name) for name in ("run", "plan_digest", "scene_sha256", "scene_bytes")}
        )
        rows = [*(episode.summary for episode in before), archive_episode(archive, parts_for(other))]
        write_tables(archive, before.meta.plan, before.meta.scenes, rows, [], NOW)
    texts = [finding.text for finding in verify(data, deep=True).findings]
    assert texts == ["office/train_id/near: 4 episodes, the plan has 3"]


@pytest.mark.parametrize("prepare", [lambda root: None, lambda root: (root / "episodes").mkdir()])
def test_directory_without_a_dataset_is_an_error(tmp_path: Path, prepare: Callable[[Path], None]) -> None:
    prepare(tmp_path)
    with pytest.raises(WorldError, match="is not a dataset"):
        verify(tmp_path)
