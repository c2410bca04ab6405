"""Checks that the scenes of a plan permit its verified instructions, and forecasts their features at sampled starts.

Simulates nothing: the starts of a run are drawn by its workers.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby, islice, zip_longest

import numpy as np

from coordinator.expansion.catalog import Catalog
from coordinator.expansion.draw import PlannedJob, expand_each
from coordinator.expansion.offers import scene_language
from coordinator.expansion.scene_cells import SceneCells, each_scene
from schemas.language.compose import Probe, composer_of, explain_impossible
from schemas.language.graph.view import look
from schemas.language.instruction import Instruction
from schemas.language.language_file import LED_STARTS, LanguageSpec
from schemas.language.scene import SceneLanguage
from schemas.measure import Goal
from schemas.plan import Plan
from schemas.scene import CompiledScene, Target, read_geometry
from schemas.start_survey import ExchangeSurvey
from schemas.support.numpy_types import Floats
from schemas.terms import TIER_RANGE_M, Tier, family_of

_TARGETS, _STARTS = 12, 4
"""Largest number of targets of a scene that are tried, and of starts for each target."""
_RANGE_M = (1.5, 7.0)
_FORECAST_SCENES = 8
"""Largest number of scenes for whose episodes sentences are forecast."""
_FORECAST_STARTS = 12
"""Largest number of starts at which the sentence of an episode is forecast."""
Pose = tuple[float, float, float]
"""x, y in metres and yaw in radians of base_link."""


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


@dataclass(frozen=True)
class LanguageForecast:
    """Expected sentences of a plan, from planned targets at starts on the grid."""

    episodes: int
    """Number of planned episodes with a start and a sentence."""
    without: int
    """Number of planned episodes for which none of the tried starts has a sentence."""
    features: Mapping[str, int]
    """Number of sentences by feature."""
    offered: Mapping[str, Mapping[str, int]]
    """Number of episodes whose start permits a feature, by feature and by scene."""
    starts: Mapping[str, int]
    """Number of episodes with a start and a sentence by scene."""
    patterns: int
    """Number of different sentence patterns."""


def forecast_language(plan: Plan, catalog: Catalog, most: int = 240) -> LanguageForecast:
    """Returns the expected sentences of a plan with a language block, of at most `most` planned episodes.

    Args:
        plan: plan that its scenes support.
        catalog: its scenes; layouts that it lacks are omitted.
        most: largest number of episodes for which a sentence is written.
    """
    assert plan.language is not None
    planned = [each for each in expand_each(plan, catalog) if not each.episode.is_false_premise]
    names = list(dict.fromkeys(map(_scene_of, planned)))
    names = names[:: max(1, math.ceil(len(names) / _FORECAST_SCENES))]
    planned = [each for each in planned if _scene_of(each) in names]
    planned = planned[:: max(1, math.ceil(len(planned) / most))]
    cells = {each.scene.name: each for each in each_scene(plan, catalog)}
    features: Counter[str] = Counter()
    starts: Counter[str] = Counter()
    patterns: set[str] = set()
    offered: dict[str, Counter[str]] = {}
    for name, group in groupby(sorted(planned, key=_scene_of), key=_scene_of):
        scene = _ForecastScene(plan, cells[name])
        for each in group:
            found = scene.sentence(each, plan.language.of_episode(each.index))
            if found is None:
                continue
            sentence, possible = found
            starts[family_of(name)] += 1
            features.update(sentence.named_features)
            patterns.add(sentence.template_id)
            for feature in possible:
                offered.setdefault(feature, Counter())[family_of(name)] += 1
    total = starts.total()
    return LanguageForecast(total, len(planned) - total, features, offered, starts=starts, patterns=len(patterns))


def _scene_of(planned: PlannedJob) -> str:
    return planned.episode.scene


class _ForecastScene:
    """Scene with the starts at which sentences are forecast."""

    def __init__(self, plan: Plan, cells: SceneCells) -> None:
        self._plan, self._cells = plan, cells
        self._scene, self._language = read_geometry(cells.entry.path), scene_language(cells.entry.path)
        self._survey = ExchangeSurvey(self._scene, self._language.graph)

    def sentence(self, planned: PlannedJob, spec: LanguageSpec) -> tuple[Instruction, set[str]] | None:
        """Returns the sentence of an episode and the features that its start permits."""
        composer, seed = composer_of(spec), (self._plan.seed, planned.index)
        leading = composer.leading_feature(np.random.default_rng(seed))
        found = []
        for target, pose in self._starts(planned, np.random.default_rng((*seed, 1))):
            number = self._language.graph.number_of[target.target_id]
            view, held_out = look(self._language.graph, pose, self._plan.camera), planned.episode.split.is_paraphrased
            written = composer.write(self._language, view, number, held_out, np.random.default_rng(seed))
            if written:
                found.append((written[0], view, number))
            if written and (leading is None or leading in written[0].named_features or len(found) > LED_STARTS):
                break
        if not found:
            return None
        is_led = leading is not None and leading in found[-1][0].named_features
        sentence, view, number = found[-1] if is_led else found[0]
        groups = composer_of(spec).offers(self._language, view, number, np.random.default_rng(seed))
        return sentence, {str(feature) for group in groups for feature in group}

    def _starts(self, planned: PlannedJob, rng: np.random.Generator) -> Iterator[tuple[Target, Pose]]:
        """Yields starts of an episode with its target, in random order."""
        episode, plan = planned.episode, self._plan
        target, noise_rad = self._scene.info.target(episode.target_id), plan.spawn.heading_noise_rad
        if plan.language is not None and plan.language.exchangeable:
            pool = [each for each in self._cells.pool(episode.split, episode.tier) if each.category == target.category]
            among, least = [each.instance_id for each in pool], plan.language.in_view + 1
            starts = self._survey.starts(among, episode.tier, least, noise_rad, plan.task)
            starts = starts.of(among.index(target.instance_id))
            for place in rng.permutation(len(starts.poses))[:_FORECAST_STARTS].tolist():
                choices = np.flatnonzero(starts.choices[place])
                x, y, yaw = starts.poses[place].tolist()
                yield pool[int(choices[rng.integers(len(choices))])], (x, y, yaw)
            return
        low, high = TIER_RANGE_M.get(episode.tier, plan.spawn.far_floor_m)
        distances = Goal.of(target, plan.task).distances(self._scene.spawns)
        points = self._scene.spawns[(distances >= low) & (distances <= high)]
        for x, y in points[rng.permutation(len(points))[:_FORECAST_STARTS]].tolist():
            towards = math.atan2(target.centroid_m[1] - y, target.centroid_m[0] - x)
            spread = math.pi if episode.tier is Tier.FAR else noise_rad
            yield target, (x, y, math.remainder(towards + rng.uniform(-spread, spread), 2 * math.pi))


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
