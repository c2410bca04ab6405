"""Training libraries in one process with the simulation: Triton's LLVM, and Stable-Baselines3 on the environment.

These tests run in `make test-train`; they are skipped without the packages.
"""

from __future__ import annotations

import subprocess
import sys
import threading
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.eval.models.messages import EvalSetup
from factory.eval.models.result import EvalEnd, Variant
from factory.eval.process.local_campaign import run_campaign
from factory.eval.results.store import EvalManifest, Store
from factory.eval.specs.campaign import Campaign
from factory.eval.specs.from_dataset import specs_of_dataset
from schemas.terms import Split

pytest.importorskip("triton")
sb3 = pytest.importorskip("stable_baselines3")

ID = "factory.gym:MiniVLANav-v0"


def run(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)


@pytest.mark.gl
def test_triton_and_torchs_compiler_load_beside_an_open_environment(drives: Dataset) -> None:
    done = run(f"""
import gymnasium, numpy
env = gymnasium.make({ID!r}, data={str(drives.root)!r}, size=64, renderer="gl")
env.reset(seed=0)
import triton, torch._dynamo
env.step(numpy.zeros(2, numpy.float32))
env.close()
print("fine")
""")
    assert (done.stdout, done.returncode) == ("fine\n", 0), done.stderr


@pytest.mark.gl
def test_a_policy_that_loads_triton_is_evaluated(drives: Dataset, tmp_path: Path) -> None:
    specs = specs_of_dataset(drives, [Split.TRAIN_ID])
    task = specs.settings.task.model_copy(update={"max_steps": 10})
    specs = specs.model_copy(update={"settings": specs.settings.model_copy(update={"task": task})})
    setup = EvalSetup(settings=specs.settings, renderer="gl", act_timeout_s=120.0)
    name = "tests.builders.policies:Compiles"
    campaign = Campaign(specs, drives.root, (name,), (Variant.ORIGINAL,), setup)
    manifest = EvalManifest(run=specs.run, specs_digest=specs.digest, with_pose=False, act_timeout_s=120.0)
    with Store(tmp_path, specs, manifest) as store:
        assert run_campaign(campaign, store, threading.Event(), lambda _pace: None)
        assert [row.end for row in store.results(name)] == [EvalEnd.TIMEOUT], store.results(name)


def make(drives: Dataset, **changes: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(ID, data=drives.root, size=64, actions="scaled", **changes)


@pytest.mark.parametrize("instruction", ["tokens", "none"])
def test_the_environment_passes_the_checker_of_stable_baselines(drives: Dataset, instruction: str) -> None:
    from stable_baselines3.common.env_checker import check_env

    opened = make(drives, instruction=instruction, with_pose=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the checker recommends other action ranges and image shapes
        check_env(opened.unwrapped)
    opened.close()


@pytest.mark.timeout(1200)
def test_ppo_trains_for_a_thousand_steps(drives: Dataset) -> None:
    import torch

    opened = make(drives, instruction="tokens")
    torch.set_num_threads(1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        model = sb3.PPO("MultiInputPolicy", opened, n_steps=250, batch_size=125, n_epochs=1, seed=0)
        before = [weights.detach().clone() for weights in model.policy.parameters()]
        model.learn(1000)
    assert model.num_timesteps == 1000
    assert any(not torch.equal(a, b) for a, b in zip(before, model.policy.parameters(), strict=True))
    observation, _ = opened.reset(seed=0)
    action, _ = model.predict(observation)
    assert opened.action_space.contains(np.asarray(action, np.float32))
    opened.close()


@pytest.mark.timeout(600)
def test_environments_of_stable_baselines_run_in_processes(drives: Dataset) -> None:
    from stable_baselines3.common.vec_env import SubprocVecEnv

    for method in ("fork", "forkserver"):
        vector = SubprocVecEnv([_Make(drives.root)] * 2, start_method=method)
        try:
            assert vector.reset()["rgb"].shape == (2, 64, 64, 3)
            after, rewards, *_ = vector.step(np.array([[1.0, 0.0]] * 2, np.float32))
            assert (rewards.shape, after["rgb"].any()) == ((2,), True)
        finally:
            vector.close()


class _Make:
    def __init__(self, root: Any) -> None:
        self.root = root

    def __call__(self) -> gymnasium.Env[Any, Any]:
        return gymnasium.make(ID, data=self.root, size=64, actions="scaled", instruction="none")
