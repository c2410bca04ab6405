"""User errors: each has the right exit code and a message that says what to do, and changes no data."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path

import pytest

from tests.acceptance.factory_cli import FactoryCli, episodes_in, wait_for
from tests.builders.ports import free_endpoint


def test_the_error_of_an_unknown_plan_lists_the_known_plans(factory, tmp_path):
    err = factory("run", "nonsense", "--out", tmp_path / "x", expect=2).stderr
    assert "demo, paper, balanced" in err
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[[scenes]]\nname = "garage"\nepisodes = 1\n', ["scenes[0].name", "garage", "office"]),
        ('[[scenes]]\nname = "office"\nepisodes = 1\nseen = ["cat"]\n', ["scenes[0].seen", "cat", "chair"]),
        ('[splits]\ntraining = 1.0\n[[scenes]]\nname = "office"\nepisodes = 1\n', ["splits.training", "train_id"]),
        ('[tiers]\nnear = 0.3\n[[scenes]]\nname = "office"\nepisodes = 1\n', ["tiers", "add up to 0.3"]),
    ],
)
def test_the_error_of_an_invalid_plan_names_the_wrong_keys(command, tmp_path, text, words):
    plan = tmp_path / "bad.toml"
    plan.write_text(text)
    err = command("run", plan, "--out", tmp_path / "x", expect=2).stderr
    assert all(word in err for word in words), err


def test_the_error_of_an_unknown_scene_lists_the_scenes_of_the_plan(command, tmp_path):
    err = command("run", "demo", "--scene", "garage", "--out", tmp_path / "x", expect=2).stderr
    assert "office" in err


def test_jobs_list_refuses_an_unknown_scene_and_suggests_a_known_one(command, reference):
    err = command("jobs", "list", reference, "--scene", "hospitl", expect=2).stderr
    assert "did you mean 'hospital'" in err


def test_an_output_that_is_a_file_is_refused(command, plan, tmp_path):
    (tmp_path / "x").write_text("mine")
    err = command("run", plan, "--out", tmp_path / "x", expect=1).stderr
    assert str(tmp_path / "x") in err
    assert (tmp_path / "x").read_text() == "mine"


def test_a_directory_of_another_plan_is_not_changed(command, reference, tmp_path):
    before = episodes_in(reference)
    err = command("run", "demo", "--scene", "hospital", "--out", reference, expect=2).stderr
    assert "choose another --out" in err
    assert "building" not in err  # the error is reported before scenes are built
    assert episodes_in(reference) == before


def test_a_directory_within_a_dataset_is_refused(command, plan, reference):
    err = command("run", plan, "--out", reference / "episodes" / "x", expect=2).stderr
    assert f"is inside the dataset {reference}" in err
    assert not (reference / "episodes" / "x").exists()


def test_files_that_do_not_belong_to_a_dataset_are_reported_before_a_dataset_is_written(command, tmp_path):
    plan, out = tmp_path / "impossible.toml", tmp_path / "x"
    plan.write_text('[[scenes]]\nname = "hospital"\nepisodes = 1\nseen = ["sofa"]\n')
    out.mkdir()
    (out / "thesis.tex").write_text("mine")
    err = command("run", plan, "--out", out, expect=2).stderr
    assert "files that do not belong to a dataset; `factory verify` will report them: thesis.tex" in err


def test_gather_refuses_a_folder_without_shards(command, plan, tmp_path):
    for folder in (tmp_path, tmp_path / "nowhere"):
        err = command("gather", plan, folder, "--out", tmp_path / "joined", expect=2).stderr
        assert f"{folder} is not a shard and contains none" in err
    assert not (tmp_path / "joined").exists()


def test_a_worker_without_a_coordinator_prints_the_start_command(command):
    err = command("worker", "--connect", free_endpoint(), "--connect-timeout", 2, expect=1).stderr
    assert "no coordinator" in err
    assert "factory coordinator start" in err


def test_listening_on_all_addresses_without_certificates_is_refused(command, plan, tmp_path):
    words = ("coordinator", "start", plan, "--out", tmp_path / "x", "--listen", "tcp/0.0.0.0:7447")
    assert "factory keys" in command(*words, expect=2).stderr


def test_two_coordinators_on_one_directory_or_one_port_are_refused(factory, command, reference_copy, plan, tmp_path):
    endpoint = free_endpoint()
    first = factory.start("coordinator", "start", "--out", reference_copy, "--listen", endpoint, "--stay")
    wait_for(lambda: (reference_copy / ".coordinator.json").exists())
    err = command("run", "--out", reference_copy, expect=1).stderr
    assert "another coordinator works on" in err
    words = ("coordinator", "start", plan, "--out", tmp_path / "x", "--listen", endpoint)
    err = command(*words, expect=1).stderr
    assert endpoint in err
    assert "--listen" in err
    first.send_signal(signal.SIGTERM)
    assert first.wait(60) == 0


def test_a_dataset_of_a_newer_format_is_refused_with_the_format_number(command, reference, tmp_path):
    root = tmp_path / "newer"
    shutil.copytree(reference, root)
    meta = json.loads((root / "dataset_meta.json").read_text())
    key = next(key for key in meta if "format" in key and isinstance(meta[key], int))
    (root / "dataset_meta.json").write_text(json.dumps({**meta, key: 99}))
    err = command("verify", root, expect=1).stderr
    assert "99" in err
    assert "newer" in err or "upgrade" in err


@pytest.mark.slow
def test_truncated_and_foreign_files_among_the_episodes_are_found_and_repaired(factory, command, reference, tmp_path):
    root = tmp_path / "hurt"
    shutil.copytree(reference, root)
    episode = root / "episodes" / "ep_000002.zip"
    episode.write_bytes(episode.read_bytes()[:-1000])
    (root / "episodes" / "ep_000009.zip").write_bytes(b"PK\x03\x04 not ours")
    report = command.json("verify", root, expect=1)
    assert {"episodes/ep_000002.zip", "episodes/ep_000009.zip"} <= {finding["file"] for finding in report["findings"]}
    factory("run", "--out", root, "--workers", 1)
    mended = command.json("verify", root, "--deep")
    assert mended["digest"] == command.json("verify", reference)["digest"]
    assert len(list((root / "quarantine").glob("ep_*"))) >= 2


def test_the_error_of_a_missing_episode_states_the_number_of_episodes(command, reference):
    assert "which has 5 episodes" in command("replay", reference, 77, expect=2).stderr
    assert "is not a dataset" in command("replay", reference.parent, 1, expect=2).stderr


def test_retrying_an_archived_episode_is_refused_with_the_reason(command, reference):
    reply = command.json("jobs", "retry", reference, 1, expect=1)
    assert reply["changed"] == []
    assert "archived" in reply["refused"]["1"]


def test_a_scene_without_the_targets_of_the_plan_is_refused_before_simulation(command, tmp_path):
    plan = tmp_path / "ask.toml"
    plan.write_text('[[scenes]]\nname = "hospital"\nepisodes = 5\nseen = ["sofa", "chair"]\n')
    err = command("run", plan, "--out", tmp_path / "x", expect=2).stderr
    assert "no reachable 'sofa'" in err
    assert "trash_can" in err
    assert not (tmp_path / "x").exists()


def test_an_unknown_expert_is_refused_with_the_known_experts(command, tmp_path):
    err = command("run", "demo", "--expert", "wizard", "--out", tmp_path / "x", expect=2).stderr
    assert "planner" in err
    assert not (tmp_path / "x").exists()


def test_a_missing_driver_of_the_required_renderer_is_reported_once_before_the_run(cache: Path, tmp_path: Path) -> None:
    without_egl = FactoryCli(tmp_path / "home", cache, {"__EGL_VENDOR_LIBRARY_DIRS": "/nowhere"})
    refused = without_egl("run", "demo", "--renderer", "gl", "--out", tmp_path / "out", expect=1)
    assert refused.stderr.count("OpenGL 4.5 with EGL is not available on this machine") == 1
    assert "apt-get install libegl1 libgl1-mesa-dri" in refused.stderr
    assert not (tmp_path / "out").exists()
