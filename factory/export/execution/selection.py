"""Selects episodes of a dataset by split and id. Does not open episodes."""

from __future__ import annotations

from collections.abc import Iterable

from factory.dataset.reader import Dataset
from schemas.errors import UsageError
from schemas.job import episode_id
from schemas.plan import MAX_EPISODES


def parse_episodes(text: str) -> list[str]:
    """Parses ids and ranges such as `1-50,ep_000060`.

    Raises:
        UsageError: a part is not a number, an id or a range.
    """
    episodes: dict[str, None] = {}
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        low, high = _number(first, text), _number(last if dash else first, text)
        if high < low:
            raise UsageError(f"--episode {text}: {part.strip()} ends before it begins")
        episodes.update(dict.fromkeys(episode_id(index) for index in range(low, high + 1)))
    return list(episodes)


def select(
    dataset: Dataset, splits: Iterable[str] = (), episodes: Iterable[str] = (), excluded: Iterable[str] = ()
) -> Dataset:
    """Returns the episodes of the given splits and ids, except excluded ids, in the order of the plan.

    Args:
        dataset: the dataset.
        splits: wanted splits; all if none are given.
        episodes: wanted ids; all if none are given.
        excluded: ids to omit.

    Raises:
        UsageError: an id is not in the dataset, or no episode is selected.
    """
    wanted_splits, wanted = list(splits), list(episodes)
    if wanted:
        there = set(dataset.column("episode_id").to_pylist())
        missing = [name for name in wanted if name not in there]
        if missing:
            rest = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
            names = ", ".join(missing[:3]) + rest
            raise UsageError(f"{dataset.root} has no {names}; it has {len(dataset)} episodes")
        dataset = dataset.filter(episode=wanted)
    held = sorted(set(dataset.column("split").to_pylist()))
    if wanted_splits:
        dataset = dataset.filter(split=wanted_splits)
    omitted = frozenset(excluded)
    if omitted:
        dataset = dataset.filter(
            episode=[name for name in dataset.column("episode_id").to_pylist() if name not in omitted]
        )
    if not len(dataset):
        within = f" in {', '.join(wanted_splits)}" if wanted_splits else ""
        raise UsageError(f"{dataset.root} has no episodes{within}; splits with episodes: {', '.join(held) or 'none'}")
    return dataset


def _number(text: str, whole: str) -> int:
    digits = text.strip().removeprefix("ep_")
    if not digits.isascii() or not digits.isdigit() or not 1 <= int(digits[:12]) <= MAX_EPISODES:
        raise UsageError(f"--episode {whole}: {text!r} is not a valid episode or range; examples: 1-50,60 or ep_000060")
    return int(digits)
