"""Options that the verbs of evaluation share."""

from __future__ import annotations

from factory.cli.common.filters import split_filter
from factory.dataset.reader import Dataset
from schemas.errors import UsageError
from schemas.terms import Split

__all__ = ["eval_split_filter", "splits_of"]

_TRAINED_ON = (Split.TRAIN_ID, Split.VAL_ID)

eval_split_filter = split_filter(f"Only this split, repeatable: {', '.join(Split)}, or all; default: the test splits.")
"""`--split SPLIT`."""


def splits_of(dataset: Dataset, asked: tuple[str, ...] | None) -> tuple[Split, ...]:
    """Returns the splits to evaluate, in the paper's order.

    Args:
        dataset: the dataset.
        asked: names of splits; empty for all that have episodes; `None` for those of them that are not for training.
    """
    if asked:
        return tuple(split for split in Split if str(split) in asked)
    present = set(dataset.metadata["split"].to_pylist())
    found = tuple(split for split in Split if str(split) in present and (asked is not None or split not in _TRAINED_ON))
    if not found:
        raise UsageError(f"{dataset.root} has episodes for training only; give --split all to evaluate on these")
    return found
