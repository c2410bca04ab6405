"""Finds the objects of a scene that can be the target of an episode. Draws no start of an episode.

If the target is drawn at the start, such an object needs a start from which another object of its category could be the
target, too, and from which each of them has a verified instruction. If an instruction that fits several objects must
fit one object in view, the object needs starts that show it without the others.

Design: docs/design/starts.md#searched-starts and docs/design/starts.md#targets-shown-alone.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numpy as np

from coordinator.expansion.catalog import SceneEntry
from coordinator.expansion.instances import Groups, NotAlone
from schemas.config import CameraConfig, TaskConfig
from schemas.instruction.referents import referents
from schemas.language.compose import composer_of
from schemas.language.graph.scene_graph import build_graph
from schemas.language.graph.view import look
from schemas.language.language_file import LanguageSpec
from schemas.language.scene import SceneLanguage
from schemas.plan import Plan, ScenePlan
from schemas.scene import Target, read_geometry
from schemas.start_survey import ClearSurvey, ExchangeStarts, ExchangeSurvey
from schemas.terms import TIER_RANGE_M, Tier

_TRIES = 8
"""Number of starts of a group at which instructions are tried."""
_LEAST_SHARE = 0.04
"""Smallest share of the starts of a target that show it without the others; the worker tries up to 256 starts, and each
takes an image."""
_KEPT_SCENES, _KEPT_OFFERS = 4, 64


@functools.lru_cache(maxsize=_KEPT_SCENES)
def scene_language(package: Path) -> SceneLanguage:
    """Returns the scene graph of a package with its verifier; keeps the results for recently used scenes.

    Raises:
        InvalidBundle: the package is damaged.
    """
    return SceneLanguage(build_graph(read_geometry(package)))


def offered_groups(plan: Plan, entry: SceneEntry) -> Groups | None:
    """Returns the groups of objects that a scene offers to every episode, i.e. without the features of limited share.

    The result is `None` if the plan names its targets, or for a catalog without packages, whose objects are all taken
    for offered.
    """
    if plan.language is None or not plan.language.exchangeable or not entry.path.is_file():
        return None
    return _groups(
        entry.path,
        entry.sha256,
        plan.language.without(plan.language.largest_shares).model_dump_json(),
        task=plan.task,
        camera=plan.camera,
        heading_noise_rad=plan.spawn.heading_noise_rad,
    )


def never_alone(plan: Plan, scene: ScenePlan, entry: SceneEntry) -> NotAlone | None:
    """Returns the objects that a scene can hardly show without the others that their instruction fits.

    The result is `None` if the plan does not require this, or for a catalog without packages.
    """
    if plan.instructions.unique != "view" or not entry.path.is_file():
        return None
    return _never_alone(
        entry.path,
        entry.sha256,
        tuple(sorted({*scene.categories.seen, *scene.categories.held_out} - {*scene.ambiguous})),
        task=plan.task,
        fov_deg=plan.camera.fov_deg,
        heading_noise_rad=plan.spawn.heading_noise_rad,
        far_m=plan.spawn.far_floor_m,
    )


@functools.lru_cache(maxsize=_KEPT_OFFERS)
def _never_alone(
    package: Path,
    sha256: str,  # noqa: ARG001 - part of the key of the cache
    categories: tuple[str, ...],
    *,
    task: TaskConfig,
    fov_deg: float,
    heading_noise_rad: float,
    far_m: tuple[float, float],
) -> NotAlone:
    scene, graph, fov_rad = read_geometry(package), scene_language(package).graph, math.radians(fov_deg)
    ranges = {Tier.NEAR: TIER_RANGE_M[Tier.NEAR], Tier.MID: TIER_RANGE_M[Tier.MID], Tier.FAR: far_m}
    lacking = set()
    for category in categories:
        targets = [each for each in scene.info.targets if each.category == category]
        if len(targets) < 2:
            continue
        survey = ClearSurvey(scene, graph, category, fov_rad)
        for target in targets:
            for is_coloured in (False, True):
                named = referents(scene.info, category, target.colour if is_coloured else None)
                others = frozenset(named - {target.instance_id})
                if not others:
                    continue
                lacking |= {
                    (target.instance_id, tier, is_coloured)
                    for tier in target.tiers(task.success, True)
                    if survey.share(
                        target,
                        others,
                        ranges[tier],
                        fov_rad / 2 if tier is Tier.FAR else heading_noise_rad,
                        needs_sight=tier is not Tier.FAR,
                        task=task,
                    )
                    < _LEAST_SHARE
                }
    return frozenset(lacking)


@functools.lru_cache(maxsize=_KEPT_OFFERS)
def _groups(
    package: Path,
    sha256: str,  # noqa: ARG001 - part of the key of the cache
    language: str,
    *,
    task: TaskConfig,
    camera: CameraConfig,
    heading_noise_rad: float,
) -> Groups:
    scene, prepared, spec = read_geometry(package), scene_language(package), LanguageSpec.model_validate_json(language)
    survey = ExchangeSurvey(scene, prepared.graph)
    groups: dict[Tier, tuple[frozenset[int], ...]] = {}
    for tier in (Tier.NEAR, Tier.MID):
        startable = [each for each in scene.info.targets if tier in each.tiers(task.success, True)]
        found: list[frozenset[int]] = []
        for category in sorted({each.category for each in startable}):
            targets = [each for each in startable if each.category == category]
            if len(targets) > spec.in_view:
                among = [each.instance_id for each in targets]
                starts = survey.starts(among, tier, spec.in_view + 1, heading_noise_rad, task)
                found += _with_sentences(prepared, spec, camera, targets, starts)
        groups[tier] = tuple(found)
    return groups


def _with_sentences(
    prepared: SceneLanguage, spec: LanguageSpec, camera: CameraConfig, targets: list[Target], starts: ExchangeStarts
) -> list[frozenset[int]]:
    """Returns the groups of objects for which a start is found from which each of them can be described."""
    found = []
    for choice in np.unique(starts.choices, axis=0):
        chosen = [target for target, is_chosen in zip(targets, choice, strict=True) if is_chosen]
        poses = starts.poses[(starts.choices == choice).all(axis=1)]
        poses = poses[np.linspace(0, len(poses) - 1, min(_TRIES, len(poses))).astype(int)]
        if any(_are_told_apart(prepared, spec, camera, chosen, tuple(pose)) for pose in poses.tolist()):
            found.append(frozenset(target.instance_id for target in chosen))
    return found


def _are_told_apart(
    prepared: SceneLanguage,
    spec: LanguageSpec,
    camera: CameraConfig,
    targets: list[Target],
    pose: tuple[float, float, float],
) -> bool:
    view, rng = look(prepared.graph, pose, camera), np.random.default_rng(spec.seed)
    numbers = [prepared.graph.number_of[target.target_id] for target in targets]
    return all(composer_of(spec).offers(prepared, view, number, rng) for number in numbers)
