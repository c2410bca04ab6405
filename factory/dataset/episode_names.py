"""Finds episodes by name or number: `ep_000012`, `12`."""

from __future__ import annotations

from schemas.errors import UsageError
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import FilePlace, Place
from schemas.storage.shard_index import episode_place
from schemas.support.shell import quoted


def episode_index(name: str) -> int:
    """Returns the number of an episode from its name.

    Raises:
        UsageError: `name` is neither an episode number nor an episode name.
    """
    digits = name.removeprefix("ep_").removesuffix(".zip")
    if not digits.isascii() or not digits.isdigit() or int(digits) < 1:
        raise UsageError(f"{name!r} is not a valid episode name; examples: ep_000012, 12")
    return int(digits)


def episode_path(root: Place, name: str) -> FilePlace:
    """Returns the path of an episode's bundle in a dataset.

    Raises:
        UsageError: the directory or the episode does not exist.
    """
    folder = root / "episodes"
    if not folder.is_dir():
        raise UsageError(
            f"{root} is not a dataset: episodes/ is missing; create a dataset with `factory run demo --out "
            f"{quoted(root)}`"
        )
    path = episode_place(root, episode_index(name))
    if not path.is_file():
        count = len(list_episodes(root).episodes)
        raise UsageError(
            f"{path.stem} does not exist in {root}, which has {count} episodes; list them with "
            f"`factory jobs list {quoted(root)}`"
        )
    return path
