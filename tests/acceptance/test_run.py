"""The main guarantee: the dataset does not depend on the number of workers or on kills."""

from __future__ import annotations

import signal
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.acceptance.factory_cli import Command, episodes_in, kill_group, wait_for
from tests.builders.ports import free_endpoint


def digest_of(command: Command, root: Path) -> str:
    report = command.json("verify", root)
    assert report["ok"], report["findings"]
    assert report["complete"]
    return report["digest"]


def test_a_finished_run_has_a_table_with_thumbnails_for_each_split_that_has_episodes(reference):
    rows = [row for path in sorted((reference / "data").iterdir()) for row in pq.read_table(path).to_pylist()]
    assert sorted(path.name for path in (reference / "data").iterdir()) == [
        "test_ood_obj-00000.parquet",
        "train_id-00000.parquet",
    ]
    assert sorted(row["index"] for row in rows) == [1, 2, 3, 4, 5]
    assert all(row["thumbnail"]["bytes"].startswith(b"\xff\xd8") for row in rows)
    assert "path: data/train_id-*.parquet" in (reference / "README.md").read_text()


def test_two_workers_produce_the_same_dataset_as_one(factory, command, plan, reference, tmp_path):
    root = tmp_path / "two"
    summary = factory.json("run", plan, "--out", root, "--workers", 2)
    assert summary["episodes"] == summary["planned"] == 5
    assert digest_of(command, root) == digest_of(command, reference)


def test_a_run_of_one_episode_starts_one_worker(factory, plan, tmp_path):
    words = ("--episodes", 1, "--record", "states", "--gate", "skip", "--workers", 3, "--verbose")
    done = factory("run", plan, *words, "--out", tmp_path / "one")
    assert done.stderr.count("worker_started") == 1


@pytest.mark.slow
def test_kills_of_coordinator_and_worker_neither_lose_nor_change_data(factory, command, plan, reference, tmp_path):
    root, endpoint = tmp_path / "chaos", free_endpoint()

    def start_coordinator():
        return factory.start("coordinator", "start", plan, "--out", root, "--listen", endpoint, "--lease", 3)

    def start_worker():
        return factory.start("worker", "--connect", endpoint, "--spool", tmp_path / "spool")

    coordinator, worker = start_coordinator(), start_worker()
    wait_for(lambda: len(episodes_in(root)) >= 1)
    kill_group(coordinator)
    kill_group(worker)
    coordinator, worker = start_coordinator(), start_worker()
    wait_for(lambda: len(episodes_in(root)) >= 3)
    kill_group(worker)
    worker = start_worker()
    assert coordinator.wait(180) == 0
    assert worker.wait(60) == 0
    assert digest_of(command, root) == digest_of(command, reference)


def test_an_interrupted_run_resumes_and_repeats_no_episode(factory, command, plan, reference, tmp_path):
    root = tmp_path / "interrupted"
    running = factory.start("run", plan, "--out", root, "--workers", 1)  # one worker, because two finish too fast
    wait_for(lambda: len(episodes_in(root)) >= 1)
    running.send_signal(signal.SIGINT)
    assert running.wait(60) == 130
    before = {name: (root / "episodes" / name).stat().st_ino for name in episodes_in(root)}
    assert 0 < len(before) < 5
    factory("run", "--out", root, "--workers", 2)
    after = {name: (root / "episodes" / name).stat().st_ino for name in episodes_in(root)}
    assert before.items() <= after.items()
    assert digest_of(command, root) == digest_of(command, reference)


@pytest.mark.slow
def test_a_killed_run_ends_its_workers_and_can_be_resumed(factory, command, plan, states, tmp_path):
    root = tmp_path / "killed"
    running = factory.start("run", plan, "--record", "states", "--out", root, "--workers", 2)
    wait_for(lambda: len(episodes_in(root)) >= 1)
    running.kill()
    running.wait(60)
    wait_for(lambda: not processes_that_name(root), 60)
    factory("run", plan, "--record", "states", "--out", root, "--workers", 2)
    assert digest_of(command, root) == digest_of(command, states)


def test_deep_verification_of_an_undisturbed_dataset_finds_nothing(command, reference):
    report = command.json("verify", reference, "--deep")
    assert report["ok"], report["findings"]
    assert report["episodes"] == 5


def test_an_episode_can_be_simulated_again_bit_for_bit(command, reference):
    replay = command.json("replay", reference, "ep_000001")
    assert replay["identical"]
    assert replay["archived_digest"] == replay["replayed_digest"]


def test_status_agrees_with_the_files_on_disk(command, reference):
    status = command.json("status", reference)
    assert status["jobs"]["archived"] == len(episodes_in(reference)) == status["planned"] == 5
    assert {name: counts["archived"] for name, counts in status["by_scene"].items()} == {
        "hospital": 3,
        "warehouse_multiple_shelves": 2,
    }
    assert sum(counts["archived"] for counts in status["by_split"].values()) == 5
    assert status["by_tier"]["near"]["archived"] == 5
    assert status["eta_s"] == 0
    assert status["finished"]
    assert len(status["workers"]) == 1


def test_status_can_be_requested_from_a_running_coordinator(factory, reference_copy):
    endpoint = free_endpoint()
    coordinator = factory.start("coordinator", "start", "--out", reference_copy, "--listen", endpoint, "--stay")
    wait_for(lambda: factory.run("status", "--connect", endpoint).returncode == 0, 60)
    assert factory.json("status", "--connect", endpoint)["jobs"]["archived"] == 5
    coordinator.send_signal(signal.SIGTERM)
    assert coordinator.wait(60) == 0


def test_held_out_categories_are_only_in_their_split(command, reference):
    jobs = command.json("jobs", "list", reference)["jobs"]
    held_out = {"fire_extinguisher", "whiteboard", "barrel", "crate"}
    assert all((job["category"] in held_out) == (job["split"] == "test_ood_obj") for job in jobs)
    history = command.json("jobs", "show", reference, "ep_000001")
    assert [event["event"] for event in history["events"]][-1] == "archived"


def test_the_json_of_a_job_has_the_fields_of_its_spec_at_the_top_level(command, reference):
    names = {"scene", "tier", "split", "category", "target_id", "colour", "template_id", "instruction"}
    listed = command.json("jobs", "list", reference)["jobs"][0]
    (draw,) = command.json("jobs", "show", reference, "ep_000001")["draws"]
    assert listed == draw
    assert {name for name in listed if name in names and isinstance(listed[name], str)} == names


def test_a_contact_sheet_is_drawn(command, reference, tmp_path):
    command("show", reference, 2, "-o", tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").read_bytes().startswith(b"\x89PNG")


def processes_that_name(root: Path) -> list[int]:
    """Returns the IDs of all processes whose command line contains the directory."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                words = (folder / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if any(str(root).encode() in word for word in words):
                found.append(int(folder.name))
    return found
