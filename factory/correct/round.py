"""Round of corrections: its plan, the command lines of its processes, and counts of its steps. Simulates nothing.

Episodes of a round are on the training split of the plan of a dataset, from other starts.
"""

from __future__ import annotations

import os
import subprocess
from typing import Any

import numpy as np

from factory.dataset.reader import Dataset
from schemas.config import CorrectionConfig, DemonstrationConfig
from schemas.errors import UsageError, WorldError
from schemas.layouts import unseen_layouts
from schemas.plan import Budget, Plan
from schemas.scene_plan import ScenePlan
from schemas.storage.place import Place
from schemas.support.apportion import apportion
from schemas.support.child import child_environment, python_module
from schemas.terms import Driver, ExpertName, Recording, Split

_BUDGET = Budget(attempts_per_draw=2, draws=3)
"""A policy that fails in every episode fails in a few attempts; the limits of a plan would repeat it 240 times."""
_SEED_STRIDE = 1_000_003
"""Difference of the seeds of two rounds, so their starts are independent."""


def correction_plan(plan: Plan, correction: CorrectionConfig, episodes: int) -> Plan:
    """Returns the plan of a round of corrections.

    It has the scenes of the training split, without the layouts and the object instances of the test splits, and
    another seed. The planner's settings are those of the plan.

    Args:
        plan: plan of the dataset on which the policy was trained.
        correction: parameters of the round.
        episodes: number of episodes, in the proportions of the plan.

    Raises:
        UsageError: the plan has no training split, or is itself one of corrections.
    """
    if plan.correction is not None:
        raise UsageError(f"plan {plan.name} is a round of corrections; give the dataset on which training began")
    trained = [scene for scene in plan.scenes if plan.splits_of(scene).get(Split.TRAIN_ID, 0.0) > 0]
    if not trained:
        raise UsageError(
            f"plan {plan.name} has no episodes in the split {Split.TRAIN_ID}, on which corrections are made"
        )
    weights = [scene.episodes * plan.splits_of(scene)[Split.TRAIN_ID] for scene in trained]
    changes = {
        "name": f"{plan.name[:40]}_corrections_{correction.round}",
        "seed": (plan.seed + _SEED_STRIDE * correction.round) % (1 << 63),
        "scenes": tuple(_only_training(scene, plan) for scene in trained),
        "splits": {Split.TRAIN_ID: 1.0},
        "expert": ExpertName.PLANNER,
        "record": Recording.STATES,
        "rig": None,
        "demonstration": DemonstrationConfig(),
        "budget": _BUDGET,
        "correction": correction,
        "extends": plan.extends or (plan.model_dump_json() if plan.disjoint_instances else None),
    }
    return _with_episodes(plan.model_copy(update=changes), weights, episodes)


def _only_training(scene: ScenePlan, plan: Plan) -> ScenePlan:
    """Returns the entry of a scene without the layouts of the unseen-scene splits, which are the last ones."""
    changes: dict[str, object] = {"splits": {}, "unseen_layouts": None}
    if scene.layouts is not None:
        changes["layouts"] = scene.layouts - unseen_layouts(scene, plan.splits_of(scene))
    return scene.model_copy(update=changes)


def _with_episodes(plan: Plan, weights: list[float], episodes: int) -> Plan:
    shares = {str(number): weight / sum(weights) for number, weight in enumerate(weights)}
    counts = apportion(shares, episodes)
    scenes = []
    for number, scene in enumerate(plan.scenes):
        count = counts.get(str(number), 0)
        if count:
            layouts = None if scene.layouts is None else min(scene.layouts, count)
            scenes.append(scene.model_copy(update={"episodes": count, "layouts": layouts}))
    return Plan.model_validate(plan.model_copy(update={"scenes": tuple(scenes)}).model_dump())


def simulation_of(policy: str, renderer: str, act_timeout_s: float, load_timeout_s: float) -> tuple[str, ...]:
    """Returns the command line of a simulation process whose episodes a policy drives."""
    limits = ("--act-timeout", str(act_timeout_s), "--load-timeout", str(load_timeout_s))
    return python_module("factory.correct.simulate", "--renderer", renderer, "--policy", policy, *limits)


def describe_policy(policy: str, act_timeout_s: float, load_timeout_s: float) -> str:
    """Returns the digest of what a policy consists of; creates the policy in another process.

    Raises:
        UsageError: the policy cannot be created.
        WorldError: its creation takes longer than its limit, or its process died.
    """
    command = (*simulation_of(policy, "auto", act_timeout_s, load_timeout_s), "--describe")
    try:
        made = subprocess.run(
            command,
            env=child_environment(os.environ),
            capture_output=True,
            text=True,
            timeout=load_timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise WorldError(f"policy {policy} was not created within {load_timeout_s:g} s (--load-timeout)") from error
    last = (made.stderr.strip().splitlines() or ["no output"])[-1]
    if made.returncode == 2:
        raise UsageError(last)
    if made.returncode:
        raise WorldError(f"policy {policy} cannot be created: {last}")
    return made.stdout.strip().splitlines()[-1]


def describe_corrections(root: Place) -> dict[str, Any]:
    """Returns the number of steps, labels and takeovers of a dataset of corrections, and the shares of the drivers."""
    by, labels, takeovers = np.zeros(len(Driver), int), 0, 0
    for episode in Dataset(root):
        with episode:
            corrections = episode.corrections
        if corrections is None:
            continue
        drivers = corrections.drivers
        by += np.bincount(drivers, minlength=len(Driver))
        labels += int(np.isfinite(corrections.expert_actions).all(axis=1).sum())
        takeovers += int(((drivers[1:] == Driver.EXPERT) & (drivers[:-1] == Driver.POLICY)).sum())
    steps = int(by.sum())
    shares = {driver.name.lower(): float(by[driver]) / max(1, steps) for driver in Driver}
    return {"steps": steps, "driven_by": shares, "labels": labels, "takeovers": takeovers}
