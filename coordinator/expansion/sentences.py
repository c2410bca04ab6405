"""Checks that the scenes of a plan permit its verified instructions, at sampled starts. Expands nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import islice, zip_longest

import numpy as np

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import expand_each
from coordinator.expansion.offers import scene_language
from coordinator.expansion.scene_cells import SceneCells, each_scene
from schemas.language.compose import Probe, composer_of, explain_impossible
from schemas.language.graph.view import look
from schemas.language.scene import SceneLanguage
from schemas.plan import Plan
from schemas.scene import CompiledScene, Target, read_geometry
from schemas.support.numpy_types import Floats

_TARGETS, _STARTS = 12, 4
"""Largest number of targets of a scene that are tried, and of starts for each target."""
_RANGE_M = (1.5, 7.0)


def find_missing_instructions(plan: Plan, scenes: Iterable[SceneCells]) -> list[str]:
    """Returns a line for each scene that has no instruction for the language block of a plan.

    A line names the features that are possible in the scene.

    Args:
        plan: plan; without a language block, the result is empty.
        scenes: scenes of the plan that fulfil its other requirements: all, or a layout that was built.
    """
    if plan.language is None:
        return []
    nouns = composer_of(plan.language).missing_nouns(
        [name for each in plan.scenes for name in sum(each.categories, ())]
    )
    missing_instructions = [f"language: {line}" for line in nouns]
    for number, cells in enumerate(scenes if not missing_instructions else ()):
        package = cells.entry.path
        probes = list(_probes(plan, cells, read_geometry(package), scene_language(package)))
        why = explain_impossible(scene_language(package), plan.language, probes) if probes else ""
        missing_instructions += [f"scenes[{number}] {cells.scene.name}: language: {why}"] if why else []
    return missing_instructions


def sample_instructions(plan: Plan, catalog: Catalog, most: int = 3) -> list[str]:
    """Returns examples of the instructions of a plan, from as many of its scenes as possible.

    Args:
        plan: plan that its scenes support.
        catalog: its scenes.
        most: largest number of examples.
    """
    samples: dict[str, list[str]] = {}
    if plan.language is None:
        for planned in expand_each(plan, catalog):
            samples.setdefault(planned.episode.scene, []).append(planned.episode.instruction)
    else:
        composer, rng = composer_of(plan.language), np.random.default_rng(plan.seed)
        for cells in each_scene(plan, catalog):
            scene = scene_language(cells.entry.path)
            probes = islice(_probes(plan, cells, read_geometry(cells.entry.path), scene), _TARGETS)
            written = [one.text for target, view in probes for one in composer.write(scene, view, target, False, rng)]
            samples[cells.scene.name] = written[:most]
    ordered = (text for texts in zip_longest(*samples.values()) for text in texts if text)
    return list(islice(dict.fromkeys(ordered), most))


def _probes(plan: Plan, cells: SceneCells, scene: CompiledScene, prepared: SceneLanguage) -> Iterator[Probe]:
    """Yields targets, each with the view from a start that faces it."""
    targets = {target.target_id: target for cell in cells.quota for target in cells.pool(*cell)}
    chosen = list(targets.values())[:: max(1, math.ceil(len(targets) / _TARGETS))]
    for target in chosen:
        for x, y in _starts(scene, target):
            yaw = math.atan2(target.centroid_m[1] - y, target.centroid_m[0] - x)
            yield prepared.graph.number_of[target.target_id], look(prepared.graph, (x, y, yaw), plan.camera)


def _starts(scene: CompiledScene, target: Target) -> list[tuple[float, float]]:
    """Returns some start points around a target, evenly spread over the surveyed points in range."""
    distances = np.linalg.norm(scene.spawns - np.asarray(target.centroid_m[:2]), axis=1)
    points: Floats = scene.spawns[(distances > _RANGE_M[0]) & (distances < _RANGE_M[1])]
    return [(float(x), float(y)) for x, y in points[:: max(1, math.ceil(len(points) / _STARTS))]]
