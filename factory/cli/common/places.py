"""Types of arguments and options: a dataset directory, a URL of object storage, a run, a shard. Opens no dataset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem

from factory.dataset.site import Site, dataset_directory, site_of
from schemas.storage.place import Place, place_of

if TYPE_CHECKING:
    from schemas.dataset.run_shard import RunShard


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
        return dataset_directory(value, "this command" if ctx is None else f"`{ctx.command_path}`")


class _ShardType(click.ParamType):  # type: ignore[type-arg]  # its type is imported only to convert a value
    name = "shard"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> RunShard:  # noqa: ARG002
        from schemas.dataset.run_shard import RunShard, parse_shard

        return value if isinstance(value, RunShard) else parse_shard(value)


SHARD = _ShardType()
"""A shard of a run, e.g. `7/200`."""
SITE = _SiteType()
"""A run: the locations of its dataset and its ledger."""
PLACE = _PlaceType()
"""A dataset to read."""
DIRECTORY = _DirectoryType()
"""A dataset in a local directory."""
