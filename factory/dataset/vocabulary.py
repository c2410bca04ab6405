"""What may stand behind a filter of a dataset: the task's words, those of its plan, and what it holds. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType

from schemas.errors import UsageError
from schemas.job import episode_id
from schemas.language import TEMPLATES
from schemas.plan import Plan
from schemas.support.suggest import did_you_mean
from schemas.terms import BUILTIN_CATEGORIES, CATEGORIES, COLOUR_NAMES, ExpertName, Split, Tier

__all__ = ["require_known"]

_SHOWN = 24


def require_known(name: str, values: Iterable[str], held: Sequence[str], plan: Plan) -> None:
    """Makes sure that every value could be one of a filter's, whether or not an episode has it.

    Args:
        name: of the filter.
        values: as asked for.
        held: the filter's values in the dataset, each once.
        plan: of the dataset.

    Raises:
        UsageError: a value is none; names those that there are.
    """
    words = _WORDS[name](plan) if name in _WORDS else ()
    is_spelt_like_one = _SPELLINGS.get(name, _is_nothing)
    for value in values:
        if value not in words and value not in held and not is_spelt_like_one(value, plan):
            there = list(dict.fromkeys((*words, *held)))
            raise UsageError(f"unknown {name} {value!r}; valid values: {_enumerate(there)}{did_you_mean(value, there)}")


def _enumerate(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return (", ".join(names[:_SHOWN]) or "none") + more


def _scenes(plan: Plan) -> tuple[str, ...]:
    return (*(scene.name for scene in plan.scenes), *BUILTIN_CATEGORIES)


def _categories(plan: Plan) -> tuple[str, ...]:
    return (*CATEGORIES, *(name for scene in plan.scenes for group in scene.categories for name in group))


def _is_nothing(value: str, plan: Plan) -> bool:  # noqa: ARG001
    return False


def _is_target(value: str, plan: Plan) -> bool:
    """Whether it is spelt as the listing of a scene would: a target that no episode has is no mistake."""
    category, _, number = value.rpartition("_")
    return category in _categories(plan) and re.fullmatch(r"[0-9]{3,}", number) is not None


def _is_episode(value: str, plan: Plan) -> bool:
    """Whether it is planned: it may have failed, or stand in another part of the dataset."""
    number = value.removeprefix("ep_")
    return re.fullmatch(r"[0-9]{6,}", number) is not None and (
        1 <= int(number) <= plan.episodes and value == episode_id(int(number))
    )


_WORDS: Mapping[str, Callable[[Plan], Sequence[str]]] = MappingProxyType(
    {
        "split": lambda _plan: tuple(map(str, Split)),
        "tier": lambda _plan: tuple(map(str, Tier)),
        "expert": lambda _plan: tuple(map(str, ExpertName)),
        "template": lambda _plan: tuple(TEMPLATES),
        "colour": lambda _plan: (*COLOUR_NAMES, "unknown"),
        "scene": _scenes,
        "category": _categories,
    }
)
"""Filter -> its words, which are right whatever a dataset holds."""
_SPELLINGS: Mapping[str, Callable[[str, Plan], bool]] = MappingProxyType({"target": _is_target, "episode": _is_episode})
"""Filter -> whether something is spelt as its values are, of which there are too many to list."""
