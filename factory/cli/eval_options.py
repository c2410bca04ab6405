"""Options that the verbs of evaluation share."""

from __future__ import annotations

from typing import Any

import click

from schemas.terms import Split

__all__ = ["SplitList"]


class SplitList(click.ParamType):
    """`S[,S...]`: splits in the paper's order; `all`, those that have episodes, becomes an empty tuple."""

    name = "splits"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[Split, ...]:
        """Returns the splits; a name that is none is a mistake of usage."""
        if isinstance(value, tuple):
            return value
        if value == "all":
            return ()
        names = [name.strip() for name in str(value).split(",") if name.strip()]
        unknown = [name for name in names if name not in set(Split)]
        if unknown or not names:
            self.fail(f"no split {', '.join(unknown) or 'is named'}; there are {', '.join(Split)}, or all", param, ctx)
        return tuple(split for split in Split if split in names)
