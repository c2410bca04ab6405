"""Options that the verbs of evaluation share."""

from __future__ import annotations

from typing import Any

import click

from factory.dataset import Dataset
from schemas.errors import UsageError
from schemas.meant import did_you_mean
from schemas.terms import Split

__all__ = ["SplitList", "splits_of"]

_TRAINED_ON = (Split.TRAIN_ID, Split.VAL_ID)


class SplitList(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
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
            known = f"there are {', '.join(Split)}, or all{did_you_mean(''.join(unknown[:1]), (*Split, 'all'))}"
            self.fail(f"no split {', '.join(unknown) or 'is named'}; {known}", param, ctx)
        return tuple(split for split in Split if split in names)


def splits_of(dataset: Dataset, asked: tuple[Split, ...] | None) -> tuple[Split, ...]:
    """Returns the splits to evaluate: as asked; all that have episodes; or, unasked, those of them not trained on."""
    if asked:
        return asked
    present = set(dataset.metadata["split"].to_pylist())
    found = tuple(split for split in Split if str(split) in present and (asked is not None or split not in _TRAINED_ON))
    if not found:
        raise UsageError(f"{dataset.root} has no episodes but for training; say --split all if they are meant")
    return found
