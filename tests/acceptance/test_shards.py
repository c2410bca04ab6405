"""Shards of a run from the command line, with a kill, joined into one dataset."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from coordinator.archive.directory import DirectoryArchive
from tests.acceptance.factory_cli import kill_group, wait_for


@pytest.mark.slow
def test_shards_of_which_one_is_killed_and_resumed_give_the_digest_of_the_run_without_shards(
    factory, command, plan, reference, tmp_path
):
    shards, scenes = tmp_path / "shards", reference / "scenes"
    run = ("run", plan, "--scenes", scenes, "--workers", 1)
    killed = factory.start(*run, "--shard", "1/2", "--out", shards / "a")
    wait_for(lambda: (shards / "a" / "run_shard.json").is_file())
    kill_group(killed)
    factory(*run, "--shard", "2/2", "--out", shards / "b")
    assert (
        "1 of 2 shards are not finished: 1/2"
        in command("gather", plan, shards, "--out", tmp_path / "joined", expect=2).stderr
    )
    factory("run", "--out", shards / "a", "--workers", 1)
    joined = command.json("gather", plan, shards, "--out", tmp_path / "joined")
    assert joined["digest"] == command.json("verify", reference)["digest"]
    assert command.json("verify", tmp_path / "joined", "--deep")["complete"]
    status = command.json("status", shards)
    assert (status["finished_shards"], status["archived"]) == (2, 5)
    assert _scene_of(shards / "a") == _scene_of(reference)


def test_a_locked_shard_is_refused_without_a_count_of_episodes(factory, plan, reference, tmp_path):
    out = tmp_path / "shard"
    with DirectoryArchive(out):
        words = ("--scenes", reference / "scenes", "--shard", "2/2", "--out", out)
        said = factory("run", plan, *words, expect=1).stderr
    assert f"another coordinator works on {out}" in said
    assert re.findall(r"\d+/\d+", said.replace(str(out), "")) == []


def _scene_of(root: Path) -> object:
    return json.loads((root / "dataset_meta.json").read_text())["scenes"]
