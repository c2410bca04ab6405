"""Runs the recipes of docs/recipes unchanged: fine-tuning of a tiny model on tokens, and the benchmark for vla-eval."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from factory.eval.driving.action import read_actions
from factory.eval.driving.policy import EpisodeInfo, PolicyInput
from factory.eval.models.messages import PolicyLimits
from factory.eval.policies.registry import make_policy
from tests.builders.dataset import make_dataset
from tests.builders.evaluation import archive_drives
from tests.builders.needs_torch import needs_torch

RECIPES = Path(__file__).parents[2] / "docs" / "recipes"
INFO = EpisodeInfo("spec_1", 7, 60, 1000, (0.0, 1.0), (-1.5, 1.5), 90.0)
needs_vla_eval = pytest.mark.skipif(
    importlib.util.find_spec("vla_eval") is None, reason="needs vla_eval: pip install vla-eval or make test-train"
)


@pytest.fixture
def recipes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Adds the folder of the recipes to the search path, so tests can import them."""
    monkeypatch.syspath_prepend(str(RECIPES))


@needs_torch
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning:torch")
def test_a_model_is_trained_on_tokens_and_drives_with_them(
    tmp_path: Path, recipes: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_dataset(tmp_path / "data", 2)
    command = [sys.executable, str(RECIPES / "finetune_tokens.py"), "--data", str(tmp_path / "data"), "--steps", "40"]
    done = subprocess.run(
        [*command, "--stride", "2", "-o", str(tmp_path / "tiny")],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(RECIPES.parents[1]), "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    losses = re.search(r"first loss ([\d.]+), mean of the last ten ([\d.]+);", done.stdout)
    assert losses is not None, done.stdout
    first, last = float(losses[1]), float(losses[2])
    assert first > 4, "the first loss is too low for an untrained model with 512 words"
    assert last < 0.5 * first
    monkeypatch.setenv("VLA_CHECKPOINT", str(tmp_path / "tiny"))
    policy = make_policy("finetune_tokens:VlaPolicy", PolicyLimits())
    policy.reset("Go to the chair.", INFO)
    rgb = np.zeros((640, 640, 3), np.uint8)
    answer = policy.act(PolicyInput(rgb=rgb, depth=np.ones((640, 640), np.float32), instruction="", step=0))
    chunk = read_actions(answer, "tokens", 1.0, 1.5)
    assert len(chunk.twists) == 6
    assert chunk.beyond == 0


@needs_torch
def test_tokens_replace_the_last_entries_of_the_vocabulary(recipes: None) -> None:
    import finetune_tokens

    every = np.array([(v, w) for v in range(7) for w in range(7)])
    ids = finetune_tokens.to_vocabulary(every, 32000)
    assert sorted(set(ids.ravel().tolist())) == list(range(31986, 32000))
    assert not set(ids[:, 0].tolist()) & set(ids[:, 1].tolist())
    for place in (0, 1):
        for token, number in zip(every[:, place], ids[:, place], strict=True):
            logits = np.zeros(32000)
            logits[5], logits[number] = 9.0, 1.0
            assert finetune_tokens.from_logits(logits, place, 32000) == token


class Straight:
    """Connection of vla-eval's runner to a policy that always drives straight ahead."""

    def __init__(self) -> None:
        self.heard: list[dict[str, Any]] = []
        self.ended: dict[str, Any] = {}

    async def start_episode(self, config: dict[str, Any]) -> None:
        self.task = config["task"]

    async def act(self, observation: dict[str, Any]) -> dict[str, Any]:
        self.heard.append(observation)
        return {"actions": np.float32((0.6, 0.0))}

    async def end_episode(self, result: dict[str, Any]) -> None:
        self.ended = result


@needs_vla_eval
def test_vla_eval_runs_an_episode(tmp_path: Path, recipes: None) -> None:
    from vla_eval.benchmarks.base import StepBenchmark
    from vla_eval.registry import resolve_import_string
    from vla_eval.runners.sync_runner import SyncEpisodeRunner
    from vla_eval.specs import check_specs

    kind = resolve_import_string("vla_eval_minivla:MiniVLANav")
    assert issubclass(kind, StepBenchmark)
    archive_drives(tmp_path / "data", 2)
    benchmark = kind(data=str(tmp_path / "data"), split="test_id", size=160)
    try:
        (task,) = benchmark.get_tasks()
        connection = Straight()
        result = asyncio.run(SyncEpisodeRunner().run_episode(benchmark, task, connection, max_steps=30))
        assert len(connection.heard) == 30
        seen = connection.heard[0]
        assert seen["images"]["front"].shape == (160, 160, 3)
        assert seen["depth"].shape == (160, 160)
        assert seen["task_description"]
        assert connection.task["name"] == task["name"]
        measures = result["metrics"]
        assert set(measures) == set(benchmark.get_metric_keys())
        assert measures["success"] is False
        assert measures["navigation_error_m"] > 0
        action, shown = benchmark.get_action_spec(), benchmark.get_observation_spec()
        assert check_specs(action, action, {"language": shown["language"]}, shown) == []
        assert action["base"].validate(np.float32((1.0, -1.5))) == []
        assert benchmark.get_metadata()["max_steps"] == 1000
        assert (benchmark.get_hold_action({"actions": (1, 1)})["actions"] == 0).all()
    finally:
        benchmark.cleanup()
