"""Whether the files that a plan names are there: stages, rules, lists of targets. Opens no stage and builds nothing."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterator
from pathlib import Path

from factory.scenes.build import load_edits
from factory.scenes.stage_file import find_fault
from schemas.errors import InvalidPlan, UsageError
from schemas.plan import Plan, ScenePlan

__all__ = ["require_files"]


def require_files(plan: Plan, kept: Collection[str] = ()) -> None:
    """Makes sure that the files of a plan's scenes can be read.

    Args:
        plan: names the files.
        kept: names of scenes of which a dataset holds the package, so that their files are not needed.

    Raises:
        InvalidPlan: a file is not there or makes no sense; all are named.
    """
    wanted = [(number, scene) for number, scene in enumerate(plan.scenes) if scene.name not in kept]
    mistakes = [f"scenes[{number}] {scene.name}: {line}" for number, scene in wanted for line in _missing_of(scene)]
    if mistakes:
        raise InvalidPlan(f"plan {plan.name!r} names files that cannot be used", mistakes)


def _missing_of(scene: ScenePlan) -> Iterator[str]:
    fault = find_fault(Path(scene.usd)) if scene.usd is not None else ""
    if fault:
        yield f"usd: {fault}"
    if scene.rules is not None:
        yield from (f"rules: {line}" for line in _refusal(scene, Path(scene.rules), None))
    if scene.targets is not None:
        targets = Path(scene.targets)
        first = (
            f"; before that `factory scene import {shlex.quote(scene.usd)} --name {scene.name}`" if scene.usd else ""
        )
        first = "" if targets.is_file() else first
        yield from (f"targets: {line}{first}" for line in _refusal(scene, None, targets))


def _refusal(scene: ScenePlan, rules: Path | None, targets: Path | None) -> Iterator[str]:
    """Yields what is wrong with a scene's edits, if anything is."""
    try:
        load_edits(rules, targets, scene.name)
    except UsageError as error:
        yield str(error)
