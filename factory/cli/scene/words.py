"""Describes in text how many targets each category has, and which instances are not targets. Prints nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

__all__ = ["say_counts", "say_rest", "say_rules"]

_MOST_NAMES = 12


def say_counts(categories: Mapping[str, int]) -> str:
    """Returns counts such as `6 shelf, 1 trash_can`, ordered by name; `none` if there are none."""
    return ", ".join(f"{categories[name]} {name}" for name in sorted(categories)) or "none"


def say_rest(others: Sequence[Mapping[str, str | None]], instances: int) -> Iterator[str]:
    """Yields lines about the instances that are not targets, with the names of some of them.

    Args:
        others: these instances, as returned by `list_other_things`.
        instances: number of instances in the scene.
    """
    yield f"not targets: {len(others)} of {instances} instances"
    nameless = [str(one["prim_path"]) for one in others if one["category"] is None]
    named = [f"{one['prim_path']} ({one['category']})" for one in others if one["category"] is not None]
    for names, why in ((nameless, "without a category"), (named, "with a category, but unreachable or excluded")):
        if names:
            yield f"  {len(names)} {why}: {_some(names)}"


def say_rules() -> str:
    """Returns how to make an instance without a category a target."""
    from factory.scenes.rules import BUILTIN_RULES

    return (
        f"to assign a category: copy {BUILTIN_RULES}, add rules, and import again with --rules FILE; for a few prims, "
        "add them to the file of `factory scene targets` and import again with --targets FILE"
    )


def _some(names: Sequence[str]) -> str:
    more = f", and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more
