"""Dataset arguments: a directory, or a URL for commands that support object storage; episode arguments: `ep_000012`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from factory.dataset.site import Site, site_of
from schemas.dataset.run_shard import RunShard, parse_shard
from schemas.errors import UsageError
from schemas.storage.episode_list import list_episodes
from schemas.storage.place import FilePlace, Place, place_of
from schemas.storage.shard_index import episode_place


def _folders(word: str) -> list[CompletionItem]:
    """Tells the shell to complete directory names; URLs are not completed."""
    return [CompletionItem(word, type="dir")]


class _SiteType(click.ParamType[Site]):
    name = "directory or URL"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        return _folders(incomplete)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Site:  # noqa: ARG002
        return value if isinstance(value, Site) else site_of(value)


class _PlaceType(click.ParamType[Place]):
    name = "directory or URL"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        return _folders(incomplete)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Place:  # noqa: ARG002
        return place_of(value)


class _DirectoryType(click.ParamType[Path]):
    name = "directory"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        return _folders(incomplete)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:  # noqa: ARG002
        place = place_of(value)
        if isinstance(place, Path):
            return place
        command = f"`{ctx.command_path}`" if ctx is not None else "this command"
        raise UsageError(
            f"{command} supports dataset directories only, not {place}: copy the dataset to a local directory first, "
            "for example with `aws s3 sync` or `rclone copy`"
        )


class _ShardType(click.ParamType[RunShard]):
    name = "shard"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> RunShard:  # noqa: ARG002
        return value if isinstance(value, RunShard) else parse_shard(value)


SHARD = _ShardType()
"""A shard of a run, e.g. `7/200`."""
SITE = _SiteType()
"""A run: the locations of its dataset and its ledger."""
PLACE = _PlaceType()
"""A dataset to read."""
DIRECTORY = _DirectoryType()
"""A dataset in a local directory."""


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
            f"{root} is not a dataset: episodes/ is missing; create a dataset with `factory run demo --out {root}`"
        )
    path = episode_place(root, episode_index(name))
    if not path.is_file():
        count = len(list_episodes(root).episodes)
        raise UsageError(
            f"{path.stem} does not exist in {root}, which has {count} episodes; list them with "
            f"`factory jobs list {root}`"
        )
    return path
