"""The shared parts of all formats: processes, output directory, selection, command line options."""

from __future__ import annotations

import errno
import json
import os
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from factory.cli.export import command
from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.execution.report_text import print_omitted
from factory.export.execution.selection import parse_episodes, select
from factory.export.options import PaperOptions
from factory.export.output import WORK_FOLDER, Output
from factory.export.registry import EXPORTERS, find_exporter
from factory.export.source import open_source
from factory.support.task_pool import run_tasks
from schemas.errors import InvalidPlan, UsageError, WorldError
from schemas.rig.rig_file import load_rig
from tests.builders.dataset import make_dataset


def square(number: int) -> int:
    return number * number


def die(number: int) -> int:
    os._exit(number)


def sleep_and_tell(path: Path) -> None:
    path.write_text(str(os.getpid()))
    time.sleep(600)


def write_and_fail(out: Output) -> None:
    with out.replacing("a.txt") as part:
        part.write_text("new")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize("workers", [0, 2])
def test_every_task_is_answered_once(workers: int) -> None:
    answers = run_tasks(square, iter(range(7)), workers, threading.Event())
    assert sorted(answers) == [0, 1, 4, 9, 16, 25, 36]


def test_tasks_are_drawn_as_processes_become_free() -> None:
    drawn = []

    def tasks() -> Iterator[int]:
        for number in range(50):
            drawn.append(number)
            yield number

    answers = run_tasks(square, tasks(), 1, threading.Event())
    next(answers)
    assert len(drawn) <= 4
    answers.close()


def test_a_dead_process_is_reported() -> None:
    with pytest.raises(WorldError, match="a process died"):
        list(run_tasks(die, [3], 1, threading.Event()))


def test_stop_ends_processes_at_once(tmp_path: Path) -> None:
    stop, told = threading.Event(), tmp_path / "pid"

    def stop_once_it_runs() -> None:
        while not told.exists() or not told.read_text():
            time.sleep(0.05)
        stop.set()

    threading.Thread(target=stop_once_it_runs, daemon=True).start()
    assert list(run_tasks(sleep_and_tell, [told], 1, stop)) == []
    assert not is_alive(int(told.read_text()))


def test_output_files_are_written_atomically(tmp_path: Path) -> None:
    with Output(tmp_path / "out") as out:
        for number in (1, 2):
            staged = out.staging_folder(f"ep_{number}")
            (staged / f"episodes/ep_{number}").mkdir(parents=True)
            (staged / f"episodes/ep_{number}/frame.png").write_bytes(b"frame")
            out.accept(f"ep_{number}", staged, '{"frames": 1}', assembles=False)
        half = out.staging_folder("ep_3")
        half.mkdir()
        (half / "frame.png").write_bytes(b"fra")
    assert sorted(path.name for path in (tmp_path / "out/episodes").iterdir()) == ["ep_1", "ep_2"]
    with Output(tmp_path / "out") as out:
        assert out.facts_path("ep_2").is_file()
        assert not out.facts_path("ep_3").exists()
        assert not out.staging_folder("ep_3").exists()


def test_finished_files_are_kept_for_the_same_pieces_only(tmp_path: Path) -> None:
    with Output(tmp_path) as out:
        out.begin_finish(["ep_1", "ep_2"])
        out.write_text("data/a.txt", "whole")
        assert out.has("data/a.txt")
    with Output(tmp_path) as out:
        out.begin_finish(["ep_1", "ep_2"])
        assert out.has("data/a.txt")
        out.begin_finish(["ep_1", "ep_2", "ep_3"])
        assert not out.has("data/a.txt")
        assert not (tmp_path / "data/a.txt").exists()


def test_failed_write_leaves_the_former_file(tmp_path: Path) -> None:
    with Output(tmp_path) as out:
        out.write_text("a.txt", "former")
        with pytest.raises(WorldError, match=r"cannot write .*a\.txt: No space left"):
            write_and_fail(out)
        assert (tmp_path / "a.txt").read_text() == "former"
        assert list((tmp_path / WORK_FOLDER / "staging").iterdir()) == []


def test_two_exports_never_work_on_one_directory(tmp_path: Path) -> None:
    with Output(tmp_path), pytest.raises(WorldError, match="another export is writing to"):
        Output(tmp_path)


def test_damaged_manifest_is_named(varied: Path, tmp_path: Path) -> None:
    order = ExportOrder(varied, tmp_path / "out", "paper", PaperOptions(), episodes=("ep_000001",))
    run_export(order)
    (tmp_path / "out/export.json").write_text("{")
    with pytest.raises(WorldError, match=r"export\.json is damaged .*choose another --out"):
        run_export(order)


def test_an_export_of_an_earlier_version_is_still_the_same_export(varied: Path, tmp_path: Path) -> None:
    """Version 1 of `export.json` has the digest of the rows as `dataset_digest`, which nothing else printed."""
    order = ExportOrder(varied, tmp_path / "out", "paper", PaperOptions(), episodes=("ep_000001",))
    first = run_export(order)
    manifest = json.loads((tmp_path / "out/export.json").read_text())
    source = manifest["source"]
    assert (source["dataset_digest"], source["record"]) == (Dataset(varied).digest, "frames")
    source["dataset_digest"] = source.pop("rows_digest")
    del source["frames_run"], source["record"]
    (tmp_path / "out/export.json").write_text(json.dumps({**manifest, "manifest": 1}))
    again = run_export(order)
    assert (again.resumed, again.complete, again.dataset_digest) == (1, True, first.dataset_digest)
    source["dataset_digest"] = "0" * 64
    (tmp_path / "out/export.json").write_text(json.dumps({**manifest, "manifest": 1}))
    with pytest.raises(WorldError, match=r"contains another export: dataset test-\w+ 0{12}, requested test-"):
        run_export(order)


def test_swapped_episode_is_noticed(varied: Path, tmp_path: Path) -> None:
    root = tmp_path / "data"
    shutil.copytree(varied, root)
    shutil.copy(root / "episodes/ep_000002.zip", root / "episodes/ep_000001.zip")
    report = run_export(
        ExportOrder(root, tmp_path / "out", "paper", PaperOptions(), episodes=("ep_000001", "ep_000002"))
    )
    assert [skip.episode_id for skip in report.skipped] == ["ep_000001"]
    assert report.episodes == 1


def test_episodes_are_named_by_number_id_and_range() -> None:
    assert parse_episodes("2-4, ep_000009,3") == ["ep_000002", "ep_000003", "ep_000004", "ep_000009"]
    for wrong in ("", "x", "0", "4-2", "1-", "-3", "1,,2"):
        with pytest.raises(UsageError, match="--episode "):
            parse_episodes(wrong)


def test_selection_keeps_the_order_of_the_plan(varied: Path) -> None:
    data = Dataset(varied)
    names = [episode.episode_id for episode in select(data, ["train_id", "test_id"], ["ep_000004", "ep_000003"])]
    assert names == ["ep_000003", "ep_000004"]
    with pytest.raises(UsageError, match="has no ep_000009; it has 4 episodes"):
        select(data, episodes=["ep_000009"])
    with pytest.raises(
        UsageError, match=r"has no episodes in val_id; splits with episodes: test_id, test_paraphrase_ood, train_id"
    ):
        select(data, ["val_id"])


def test_command_line_takes_the_options_of_every_format() -> None:
    shown = CliRunner().invoke(command, ["--help"]).output
    for name in EXPORTERS:
        for field, info in find_exporter(name).options.model_fields.items():
            assert f"--{field.replace('_', '-')}" in shown
            assert info.description, f"{name}: {field} has no description"


def test_the_command_exports_in_processes_and_prints_the_result(varied: Path, tmp_path: Path) -> None:
    words = [
        str(varied),
        "--to",
        "paper",
        "-o",
        str(tmp_path / "out"),
        "--split",
        "train_id",
        "--workers",
        "2",
        "--json",
    ]
    done = CliRunner().invoke(command, words, standalone_mode=False)
    assert done.return_value == 0
    told = json.loads(done.stdout)
    assert (told["episodes"], told["frames"], told["complete"], told["skipped"]) == (2, 35, True, [])
    assert told["bytes"] == sum(path.stat().st_size for path in (tmp_path / "out").rglob("*") if path.is_file())


def test_the_command_names_skipped_episodes_and_exits_with_1(varied: Path, tmp_path: Path) -> None:
    shutil.copytree(varied, tmp_path / "data")
    (tmp_path / "data/episodes/ep_000002.zip").write_bytes(b"rubbish")
    words = [str(tmp_path / "data"), "--to", "paper", "-o", str(tmp_path / "out"), "--workers", "1"]
    done = CliRunner().invoke(command, words, standalone_mode=False)
    assert done.return_value == 1
    assert "skipped ep_000002:" in done.stderr
    assert "1 episodes skipped" in done.stdout


def test_the_command_names_missing_episodes_of_the_plan_and_exits_with_1(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 1, planned=7)
    words = [str(tmp_path / "data"), "--to", "vlnce", "-o", str(tmp_path / "out"), "--workers", "1"]
    for _ in range(2):  # the second run finds everything complete
        done = CliRunner().invoke(command, words, standalone_mode=False)
        assert done.return_value == 1
        assert "missing in the dataset: ep_000002, ep_000003, ep_000004, ep_000005, ep_000006 and 1 more" in done.stderr
        assert "6 episodes missing in the dataset" in done.stdout
    chosen = [*words[:4], str(tmp_path / "one"), "--episode", "1"]
    assert CliRunner().invoke(command, chosen, standalone_mode=False).return_value == 0


def test_option_of_another_format_is_refused(varied: Path, tmp_path: Path) -> None:
    words = [str(varied), "--to", "paper", "-o", str(tmp_path / "out"), "--depth"]
    with pytest.raises(UsageError, match="--depth not valid for format paper; valid format options: --split-names"):
        CliRunner().invoke(command, words, standalone_mode=False, catch_exceptions=False)


def test_dry_run_writes_nothing(varied: Path, tmp_path: Path) -> None:
    words = [str(varied), "--to", "paper", "-o", str(tmp_path / "out"), "--dry-run", "--workers", "2"]
    done = CliRunner().invoke(command, words, standalone_mode=False)
    assert done.return_value == 0
    assert "4 episodes, 60 frames" in done.stdout
    assert "measured with ep_" in done.stdout
    assert not (tmp_path / "out").exists()


def refuse(number: int) -> int:
    raise InvalidPlan(f"plan {number} is impossible", ["scenes[0]: no chair"])


def test_the_findings_of_an_error_in_a_process_reach_the_caller():
    with pytest.raises(InvalidPlan, match="plan 7 is impossible:\n  - scenes") as caught:
        list(run_tasks(refuse, [7], 1, threading.Event()))
    assert caught.value.findings == ("scenes[0]: no chair",)


def test_episodes_that_the_splits_leave_out_are_reported(
    varied: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ("ep_000001", "ep_000002", "ep_000003")
    report = run_export(
        ExportOrder(varied, tmp_path / "out", "paper", PaperOptions(), splits=("train_id",), episodes=asked)
    )
    assert (report.episodes, report.unselected) == (1, ("ep_000001", "ep_000003"))
    print_omitted(report)
    assert "--split does not select their splits: ep_000001, ep_000003; omit --split" in capsys.readouterr().err
    whole = run_export(ExportOrder(varied, tmp_path / "whole", "paper", PaperOptions(), episodes=asked))
    assert (whole.episodes, whole.unselected) == (3, ())


def test_a_rig_of_the_plan_that_is_not_exported_is_named_and_its_name_selects_it(
    varied: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "data"
    shutil.copytree(varied, root)
    described = json.loads((root / "dataset_meta.json").read_text())
    rig = load_rig("turtlebot4").model_copy(update={"name": "own-rig"})
    described["plan"]["rig"] = rig.model_dump(mode="json")
    (root / "dataset_meta.json").write_text(json.dumps(described))
    report = run_export(ExportOrder(root, tmp_path / "out", "paper", PaperOptions(), episodes=("ep_000001",)))
    assert report.rig_left_out == "own-rig"
    print_omitted(report)
    assert "to export the sensors of the dataset's rig, add --rig own-rig" in capsys.readouterr().err
    assert open_source(root).rig is None
    assert open_source(root, "own-rig").rig == rig
    with pytest.raises(UsageError, match="no rig "):
        open_source(root, "other-rig")
