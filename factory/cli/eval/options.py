"""Options that the evaluation commands share."""

from __future__ import annotations

from factory.cli.common.filters import split_filter
from factory.dataset.reader import Dataset
from schemas.errors import UsageError
from schemas.terms import Split

__all__ = ["eval_split_filter", "splits_of"]

_TRAINED_ON = (Split.TRAIN_ID, Split.VAL_ID)

eval_split_filter = split_filter(
    f"Split to include; repeatable. Values: {', '.join(Split)}, all. Default: the test splits."
)
"""`--split SPLIT`."""


def splits_of(dataset: Dataset, asked: tuple[str, ...] | None) -> tuple[Split, ...]:
    """Returns the splits to evaluate, in the paper's order.

    Args:
        dataset: the dataset.
        asked: names of splits; empty for all splits with episodes, `None` for all test splits with episodes.
    """
    if asked:
        return tuple(split for split in Split if str(split) in asked)
    present = set(dataset.metadata["split"].to_pylist())
    found = tuple(split for split in Split if str(split) in present and (asked is not None or split not in _TRAINED_ON))
    if not found:
        raise UsageError(
            f"{dataset.root} has no episodes in test splits; evaluate on its other splits with --split all"
        )
    return found
