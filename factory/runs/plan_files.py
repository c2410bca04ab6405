"""Checks that the files named in a plan can be read: scenes, rules, target lists. Opens no scene and builds nothing."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterator
from pathlib import Path

from factory.scenes.build import load_edits
from factory.scenes.stage_file import find_fault
from schemas.errors import InvalidPlan, UsageError
from schemas.plan import Plan, ScenePlan


def require_files(plan: Plan, kept: Collection[str] = ()) -> None:
    """Raises an error unless the files of all scenes of a plan can be read.

    Args:
        plan: Plan with the file names.
        kept: Names of scenes whose package is in the dataset, so their files are not needed.

    Raises:
        InvalidPlan: A file is missing or invalid; the message lists all such files.
    """
    wanted = [(number, scene) for number, scene in enumerate(plan.scenes) if scene.name not in kept]
    mistakes = [f"scenes[{number}] {scene.name}: {line}" for number, scene in wanted for line in _missing_of(scene)]
    if mistakes:
        raise InvalidPlan(f"plan {plan.name!r} names files that cannot be used", mistakes)


def _missing_of(scene: ScenePlan) -> Iterator[str]:
    fault = find_fault(Path(scene.file)) if scene.file is not None else ""
    if fault:
        yield f"file: {fault}"
    if scene.rules is not None:
        yield from (f"rules: {line}" for line in _refusal(scene, Path(scene.rules), None))
    if scene.targets is not None:
        targets = Path(scene.targets)
        first = (
            f"; before that `factory scene import {shlex.quote(scene.file)} --name {scene.name}`" if scene.file else ""
        )
        first = "" if targets.is_file() else first
        yield from (f"targets: {line}{first}" for line in _refusal(scene, None, targets))


def _refusal(scene: ScenePlan, rules: Path | None, targets: Path | None) -> Iterator[str]:
    """Yields the errors of the rules and target list of a scene."""
    try:
        load_edits(rules, targets, scene.name)
    except UsageError as error:
        yield str(error)
