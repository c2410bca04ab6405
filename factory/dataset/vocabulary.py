"""Validates filter values of a dataset against the vocabulary of the task, the plan and the dataset. Pure functions."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType

from schemas.errors import UsageError
from schemas.instruction.templates import TEMPLATES
from schemas.job import episode_id
from schemas.plan import Plan
from schemas.support.suggest import did_you_mean
from schemas.terms import BUILTIN_CATEGORIES, CATEGORIES, COLOUR_NAMES, ExpertName, Split, Tier

_SHOWN = 24


def require_known(name: str, values: Iterable[str], held: Callable[[], Sequence[str]], plan: Plan) -> None:
    """Raises an error unless every value is valid for a filter; a valid value may have no episode.

    Args:
        name: Name of the filter.
        values: Requested values that no episode of the dataset has.
        held: Function that returns the values that occur in the dataset.
        plan: Plan of the dataset.

    Raises:
        UsageError: A value is not valid; the message lists the valid values.
    """
    words = _WORDS[name](plan) if name in _WORDS else ()
    has_valid_form = _SPELLINGS.get(name, _has_no_form)
    for value in values:
        if value not in words and not has_valid_form(value, plan):
            there = list(dict.fromkeys((*words, *held())))
            raise UsageError(f"unknown {name} {value!r}; valid values: {_enumerate(there)}{did_you_mean(value, there)}")


def _enumerate(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return (", ".join(names[:_SHOWN]) or "none") + more


def _scenes(plan: Plan) -> tuple[str, ...]:
    return (*(part.name for part in (*plan.scenes, *plan.parts)), *BUILTIN_CATEGORIES)


def _categories(plan: Plan) -> tuple[str, ...]:
    return (*CATEGORIES, *(name for scene in plan.scenes for group in scene.categories for name in group))


def _has_no_form(value: str, plan: Plan) -> bool:  # noqa: ARG001
    return False


def _is_target(value: str, plan: Plan) -> bool:
    """Returns whether a value has the form of a target id, such as `rack_001`; it need not occur in an episode."""
    category, _, number = value.rpartition("_")
    return category in _categories(plan) and re.fullmatch(r"[0-9]{3,}", number) is not None


def _is_episode(value: str, plan: Plan) -> bool:
    """Returns whether a value is the id of a planned episode; the episode need not be archived."""
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
"""Filter -> function that returns the valid values that are known from the plan."""
_SPELLINGS: Mapping[str, Callable[[str, Plan], bool]] = MappingProxyType({"target": _is_target, "episode": _is_episode})
"""Filter with too many valid values to list -> function that returns whether a value has a valid form."""
