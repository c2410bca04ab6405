"""Naming an episode on the command line: `ep_000012` or `12`."""

from __future__ import annotations

from schemas.errors import UsageError
from schemas.job import episode_id
from schemas.storage.place import Place

__all__ = ["episode_index", "episode_path"]


def episode_index(name: str) -> int:
    """Returns the number in an episode's name.

    Raises:
        UsageError: it is neither a number nor a name of an episode.
    """
    digits = name.removeprefix("ep_").removesuffix(".zip")
    if not digits.isascii() or not digits.isdigit() or int(digits) < 1:
        raise UsageError(f"{name!r} names no episode; write ep_000012 or 12")
    return int(digits)


def episode_path(root: Place, name: str) -> Place:
    """Returns the bundle of an episode of a dataset.

    Raises:
        UsageError: the directory or the episode is not there.
    """
    folder = root / "episodes"
    if not folder.is_dir():
        raise UsageError(f"{root} is no dataset: it has no episodes/ (make one with `factory run demo --out {root}`)")
    path = folder / f"{episode_id(episode_index(name))}.zip"
    if not path.is_file():
        count = len(list(folder.glob("ep_*.zip")))
        raise UsageError(f"{root} has no {path.stem}; it holds {count} episodes (see `factory jobs list {root}`)")
    return path
