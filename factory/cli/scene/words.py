"""In words: how many things of which category, and what in a scene is no target. Prints nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

__all__ = ["say_counts", "say_rest", "say_rules"]

_MOST_NAMES = 12


def say_counts(categories: Mapping[str, int]) -> str:
    """Returns `6 shelf, 1 trash_can`, in the order of the names; `none` where there is nothing."""
    return ", ".join(f"{categories[name]} {name}" for name in sorted(categories)) or "none"


def say_rest(others: Sequence[Mapping[str, str | None]], instances: int) -> Iterator[str]:
    """Yields lines on the things that are no target, some of them by name.

    Args:
        others: those things, as `list_other_things` returns them.
        instances: how many things the scene has.
    """
    yield f"no target: {len(others)} of {instances} instances"
    nameless = [str(one["prim_path"]) for one in others if one["category"] is None]
    named = [f"{one['prim_path']} ({one['category']})" for one in others if one["category"] is not None]
    for names, why in ((nameless, "of no known category"), (named, "of a category, but out of reach or left out")):
        if names:
            yield f"  {len(names)} {why}: {_some(names)}"


def say_rules() -> str:
    """Returns how a thing of no known category becomes a target."""
    from factory.scenes.rules import BUILTIN_RULES

    return (
        f"to name a category: copy {BUILTIN_RULES}, add to it, and import again with --rules FILE; for a few prims "
        "list them in the file of `factory scene targets` and give --targets FILE"
    )


def _some(names: Sequence[str]) -> str:
    more = f", and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more
