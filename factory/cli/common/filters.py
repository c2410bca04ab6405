"""Filter options: `--split --scene --tier --state`, each repeatable; values may also be separated by commas."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from schemas.support.suggest import did_you_mean
from schemas.terms import BUILTIN_CATEGORIES, Split, Tier

Command = TypeVar("Command", bound=Callable[..., Any])

ALL = "all"
"""The value that selects everything."""


class _Names(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """`A[,B...]` as a tuple of names, checked against the valid names if they are known; `all` is an empty tuple."""

    def __init__(self, name: str, known: Sequence[str] = ()) -> None:
        self.name = name
        self._known = known

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Returns the names; an unknown name is a usage error."""
        if isinstance(value, tuple):
            return value
        names = tuple(name.strip() for name in str(value).split(",") if name.strip())
        if ALL in names:
            return ()
        unknown = [name for name in names if self._known and name not in self._known]
        if unknown or not names:
            valid = f"valid values: {', '.join(self._known)}, {ALL}" if self._known else f"give a name, or {ALL}"
            near = did_you_mean("".join(unknown[:1]), (*self._known, ALL))
            what = f"unknown {self.name} {', '.join(map(repr, unknown))}" if unknown else "empty value"
            self.fail(f"{what}; {valid}{near}", param, ctx)
        return names

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        """Completes the last name in the list."""
        before, comma, last = incomplete.rpartition(",")
        return [CompletionItem(f"{before}{comma}{name}") for name in self._known if name.startswith(last)]


def filter_option(
    flag: str,
    name: str,
    known: Iterable[str] = (),
    text: str | None = None,
) -> Callable[[Command], Command]:
    """Returns an option whose values are collected in one tuple: `None` when not given, empty for `all`.

    Args:
        flag: the option, e.g. `--split`.
        name: name of the parameter.
        known: valid values; empty when they are not known in advance.
        text: help text; by default a text that lists the valid values.
    """
    word, names = flag.lstrip("-"), tuple(map(str, known))
    return click.option(
        flag,
        name,
        multiple=True,
        type=_Names(word, names),
        metavar=word.upper(),
        callback=_flatten,
        help=text or f"{word.capitalize()} to include; repeatable. Values: {', '.join(names)}. Default: all.",
    )


def split_filter(text: str | None = None) -> Callable[[Command], Command]:
    """`--split SPLIT` as `splits`."""
    return filter_option("--split", "splits", Split, text)


def tier_filter() -> Callable[[Command], Command]:
    """`--tier TIER` as `tiers`."""
    return filter_option("--tier", "tiers", Tier)


def scene_filter() -> Callable[[Command], Command]:
    """`--scene SCENE` as `scenes`. Names are not checked, because imported scenes can have any name."""
    known = ", ".join(BUILTIN_CATEGORIES)
    return filter_option("--scene", "scenes", (), f"Scene to include; repeatable. Built-in: {known}. Default: all.")


def _flatten(context: click.Context, param: click.Parameter, given: Any) -> tuple[str, ...] | None:  # noqa: ARG001
    if not given:
        return None
    if () in given:
        return ()
    return tuple(dict.fromkeys(name for names in given for name in names))
