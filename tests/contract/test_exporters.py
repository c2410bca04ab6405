"""Contract suite of exporters on a small dataset: completeness, determinism, resuming, refusals, damage, full disks."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.export.execution.estimate import estimate_export
from factory.export.execution.export_run import ExportOrder, ExportProgress, run_export
from factory.export.execution.manifest import MANIFEST_FILE, read_manifest
from factory.export.origin import find_origin, origin_of
from factory.export.output import WORK_FOLDER
from factory.export.registry import EXPORTERS, find_exporter
from schemas.errors import UsageError, WorldError
from schemas.support.extras import EXTRA_OF, install_command
from tests.builders.dataset import make_dataset

EPISODES = 3
every_format = pytest.mark.parametrize("name", list(EXPORTERS))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset that tests only read."""
    root = tmp_path_factory.mktemp("exported") / "data"
    make_dataset(root, EPISODES)
    return root


@pytest.fixture(scope="module")
def reference(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Exports without interruptions."""
    place = tmp_path_factory.mktemp("reference")
    return {name: _exported(dataset, place / name, name) for name in EXPORTERS}


def order(root: Path, out: Path, name: str) -> ExportOrder:
    return ExportOrder(root=root, out=out, format=name, options=find_exporter(name).options())


def _exported(root: Path, out: Path, name: str) -> Path:
    assert run_export(order(root, out, name)).complete
    return out


def contents(root: Path) -> dict[str, bytes]:
    """Returns every file of an export except working files."""
    files = (path for path in root.rglob("*") if path.is_file())
    inside = ((path.relative_to(root), path) for path in files)
    return {str(name): path.read_bytes() for name, path in inside if name.parts[0] != WORK_FOLDER}


@every_format
def test_an_export_describes_itself_and_leaves_no_temporary_files(reference: dict[str, Path], name: str) -> None:
    manifest = read_manifest(reference[name])
    assert manifest is not None
    assert (manifest.format, manifest.complete, manifest.episodes) == (name, True, EPISODES)
    assert not (reference[name] / WORK_FOLDER).exists()
    assert len(contents(reference[name])) > 1


@every_format
def test_two_exports_of_a_dataset_have_equal_bytes(
    dataset: Path, reference: dict[str, Path], tmp_path: Path, name: str
) -> None:
    again = contents(_exported(dataset, tmp_path / "again", name))
    assert again == contents(reference[name])


@every_format
def test_a_complete_export_is_not_repeated(dataset: Path, reference: dict[str, Path], name: str) -> None:
    before = {path: path.stat().st_mtime_ns for path in reference[name].rglob("*")}
    report = run_export(order(dataset, reference[name], name))
    assert (report.complete, report.episodes, report.resumed) == (True, EPISODES, EPISODES)
    assert {path: path.stat().st_mtime_ns for path in reference[name].rglob("*") if path in before} == before


@every_format
def test_an_interrupted_export_resumes(dataset: Path, reference: dict[str, Path], tmp_path: Path, name: str) -> None:
    stop = threading.Event()

    def stop_after_one(progress: ExportProgress) -> None:
        if progress.done:
            stop.set()

    def stop_before_the_last_files(progress: ExportProgress) -> None:
        if progress.stage == "finishing":
            stop.set()

    report = run_export(order(dataset, tmp_path / "out", name), stop_after_one, stop)
    assert (report.complete, report.finished, report.episodes) == (False, False, 1)
    stop.clear()
    report = run_export(order(dataset, tmp_path / "out", name), stop_before_the_last_files, stop)
    assert (report.complete, report.finished, report.resumed) == (False, False, 1)
    report = run_export(order(dataset, tmp_path / "out", name))
    assert (report.complete, report.resumed) == (True, EPISODES)
    assert contents(tmp_path / "out") == contents(reference[name])


@every_format
def test_an_export_names_what_replays_each_episode(dataset: Path, reference: dict[str, Path], name: str) -> None:
    for number, episode in enumerate(Dataset(dataset), 1):
        origin = find_origin(reference[name], str(number))
        assert origin == origin_of(episode)
        job, row = origin.job, episode.summary
        assert (origin.episode, job.index, job.attempt) == (row.episode_id, row.index, row.attempt)
        assert (job.scene_sha256, job.plan_digest, job.root_seed) == (row.scene_sha256, row.plan_digest, 42)
        assert origin.states_digest == episode.states_digest
        assert origin.version == json.loads(row.software).get("minivla-factory", "unknown")


@every_format
def test_an_episode_that_an_export_lacks_is_refused(reference: dict[str, Path], name: str) -> None:
    with pytest.raises(UsageError, match=r"has no episode ep_000009; it has ep_00000"):
        find_origin(reference[name], "9")


_HARD_TIMES = """
import os, resource, signal, sys
from pathlib import Path
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.registry import find_exporter
from schemas.errors import WorldError

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
root, out, name = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
order = ExportOrder(root=root, out=out, format=name, options=find_exporter(name).options())
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
try:
    run_export(order, lambda progress: resource.setrlimit(resource.RLIMIT_FSIZE, (600, hard)))
except WorldError as error:
    print(error, flush=True)
resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
print(sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file() and ".export" not in p.parts), flush=True)
print(sum(1 for p in (out / ".export").rglob("*") if ".part" in p.name or "staging" in p.parts and p.is_file()))
sys.stdout.flush()
run_export(order, lambda progress: os._exit(9) if progress.done else None)
"""


@pytest.mark.slow
@every_format
def test_full_disk_and_kill_leave_only_whole_files(
    dataset: Path, reference: dict[str, Path], tmp_path: Path, name: str
) -> None:
    """A file size limit simulates a full disk: both raise an OSError during a write."""
    out = tmp_path / "out"
    command = [sys.executable, "-c", _HARD_TIMES, dataset, out, name]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 9, done.stderr
    message, files, leftovers = done.stdout.splitlines()
    assert "cannot write" in message
    assert "File too large" in message
    assert leftovers == "0"
    assert set(eval(files)) <= set(contents(reference[name]))
    assert {file: data for file, data in contents(out).items() if file != MANIFEST_FILE}.items() <= (
        contents(reference[name]).items()
    )
    assert run_export(order(dataset, out, name)).complete
    assert contents(out) == contents(reference[name])


@every_format
def test_an_export_to_a_full_disk_leaves_only_complete_files(
    dataset: Path, reference: dict[str, Path], tmp_path: Path, name: str
) -> None:
    whole = contents(reference[name])
    with disk_of(tmp_path / "disk", sum(map(len, whole.values())) // 2) as disk:
        with pytest.raises(WorldError, match="No space left on device"):
            run_export(order(dataset, disk / "out", name))
        found = contents(disk / "out")
        assert {file: data for file, data in found.items() if file != MANIFEST_FILE}.items() <= whole.items()
        assert not [path for path in (disk / "out" / WORK_FOLDER / "staging").rglob("*") if path.is_file()]
        subprocess.run(["mount", "-o", "remount,size=1g", str(disk)], check=True)
        assert run_export(order(dataset, disk / "out", name)).complete
        assert contents(disk / "out") == whole


@contextlib.contextmanager
def disk_of(path: Path, size_bytes: int) -> Iterator[Path]:
    """Mounts a disk of `size_bytes`, at least a few pages, and yields its path; requires root."""
    path.mkdir()
    size = max(size_bytes, 4 * 4096)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "small", str(path)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("mounting a tmpfs needs root")
    try:
        yield path
    finally:
        subprocess.run(["umount", "--lazy", str(path)], check=True)


@every_format
def test_damaged_and_missing_episodes_are_skipped_and_named(
    dataset: Path, reference: dict[str, Path], tmp_path: Path, name: str
) -> None:
    shutil.copytree(dataset, tmp_path / "data")
    damaged, missing = (tmp_path / f"data/episodes/ep_00000{number}.zip" for number in (1, 3))
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:-10])
    missing.rename(tmp_path / "away.zip")
    out = tmp_path / "out"
    report = run_export(order(tmp_path / "data", out, name))
    assert [(skip.episode_id, report.episodes, report.finished) for skip in report.skipped] == [
        ("ep_000001", 1, True),
        ("ep_000003", 1, True),
    ]
    assert "is damaged" in report.skipped[0].reason
    assert "is missing" in report.skipped[1].reason
    assert not report.complete
    damaged.write_bytes(whole)
    (tmp_path / "away.zip").rename(missing)
    report = run_export(order(tmp_path / "data", out, name))
    assert (report.complete, report.resumed, report.skipped) == (True, 1, ())
    assert contents(out) == contents(reference[name])


@every_format
def test_nothing_is_written_when_no_episode_is_readable(dataset: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(dataset, tmp_path / "data")
    for path in (tmp_path / "data/episodes").iterdir():
        path.write_bytes(b"PK rubbish")
    with pytest.raises(WorldError, match=r"none of 3 episodes could be exported: ep_000001: .*is damaged"):
        run_export(order(tmp_path / "data", tmp_path / "out", name))
    assert list(contents(tmp_path / "out")) == [MANIFEST_FILE]


@every_format
def test_export_of_another_dataset_is_refused(
    reference: dict[str, Path], tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    other = tmp_path_factory.mktemp("other") / "data"
    make_dataset(other, 1)
    before = contents(reference[name])
    with pytest.raises(
        WorldError, match=r"contains another export: dataset test-.*; delete it, or choose another --out"
    ):
        run_export(order(other, reference[name], name))
    assert contents(reference[name]) == before


@every_format
def test_an_export_of_other_episodes_into_the_same_folder_is_refused(
    dataset: Path, reference: dict[str, Path], name: str
) -> None:
    wanted = order(dataset, reference[name], name)
    with pytest.raises(WorldError, match="contains another export: episodes 3 of all splits"):
        run_export(ExportOrder(dataset, reference[name], name, wanted.options, episodes=("ep_000002",)))


@every_format
def test_an_export_in_another_format_into_the_same_folder_is_refused(
    dataset: Path, reference: dict[str, Path], name: str
) -> None:
    other = next(other for other in EXPORTERS if other != name)
    with pytest.raises(WorldError, match=f"format {name}, requested {other}"):
        run_export(order(dataset, reference[name], other))


@every_format
def test_a_dry_run_reports_sizes_and_writes_nothing(
    dataset: Path, reference: dict[str, Path], tmp_path: Path, name: str
) -> None:
    estimate = estimate_export(order(dataset, tmp_path / "out", name))
    assert not (tmp_path / "out").exists()
    size = sum(map(len, contents(reference[name]).values()))
    assert 0.8 * size <= estimate.bytes <= 3.2 * size  # the estimate counts shared files once for each episode
    assert estimate.episodes == EPISODES
    assert estimate.frames == read_manifest(reference[name]).frames  # type: ignore[union-attr]
    assert estimate.fits
    assert estimate.seconds > 0


@every_format
def test_missing_package_is_named_with_its_extra(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    required = find_exporter(name).requires
    for module in required:
        remedy = re.escape(install_command(EXTRA_OF.get(module)))
        message = rf"needs the package {module}, which is not installed; .*{remedy}"
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, module, None)
            with pytest.raises(UsageError, match=message):
                run_export(order(dataset, tmp_path / "out", name))
    assert not (tmp_path / "out").exists()


@every_format
def test_export_into_the_dataset_is_refused(dataset: Path, name: str) -> None:
    for out in (dataset, dataset / "out", dataset.parent):
        with pytest.raises(UsageError, match="cannot be inside the dataset"):
            run_export(order(dataset, out, name))
    assert len(Dataset(dataset)) == EPISODES


@every_format
def test_a_folder_with_other_files_is_refused(dataset: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(WorldError, match="is not an export"):
        run_export(order(dataset, tmp_path, name))
    assert contents(tmp_path) == {"thesis.txt": b"years of work"}
