"""Changes plans to the number of scenes and episodes of a benchmark."""

from __future__ import annotations

from collections.abc import Sequence

from coordinator.expansion.file import shrink
from schemas.errors import UsageError
from schemas.plan import Plan


def narrow(plan: Plan, scenes: Sequence[str], episodes: int) -> Plan:
    """Returns the plan with `episodes` episodes in each of these scenes, or in every scene if `scenes` is empty.

    Raises:
        UsageError: A scene is not in the plan, or the plan has fewer than `episodes` episodes in a scene.
    """
    names = list(scenes) or [scene.name for scene in plan.scenes]
    parts = tuple(shrink(plan, scenes=(name,), episodes=1).scenes[0] for name in dict.fromkeys(names))
    found = {scene.name: scene.episodes for scene in plan.scenes}
    short = [f"{found[part.name]} of {part.name}" for part in parts if found[part.name] < episodes]
    if short:
        raise UsageError(
            f"--episodes {episodes}: plan {plan.name!r} has fewer episodes ({', '.join(short)}); choose another PLAN"
        )
    return plan.model_copy(update={"scenes": tuple(part.model_copy(update={"episodes": episodes}) for part in parts)})


def enlarge(plan: Plan, episodes: int) -> Plan:
    """Returns the plan with at least `episodes` episodes, in the same proportions."""
    times = -(-episodes // plan.episodes)
    scenes = (scene.model_copy(update={"episodes": scene.episodes * times}) for scene in plan.scenes)
    return plan.model_copy(update={"scenes": tuple(scenes)})
