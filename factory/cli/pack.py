"""`factory pack`: packs the episodes of a states dataset into shards."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from factory.cli.options import json_option, site_argument
from schemas.errors import UsageError
from schemas.terms import Recording

if TYPE_CHECKING:
    from factory.dataset.site import Site


@click.command("pack")
@site_argument
@json_option
def command(site: Site, as_json: bool) -> None:
    """Pack the episodes of a states dataset into shards.

    A shard is one file with the episodes of 1,000 consecutive numbers. Runs of more than 1,000 episodes pack
    automatically. Stop the coordinator of the dataset first. Files that differ from the tables remain as they are.
    """
    from coordinator.archive.opening import open_archive
    from coordinator.packing import pack_all
    from factory.dataset.reader import Dataset
    from factory.support.logs import configure_logs
    from factory.support.terminal import print_json

    configure_logs()
    dataset = Dataset(site.place)
    if dataset.meta.plan.record is not Recording.STATES:
        raise UsageError(f"{site} stores frames; only datasets of `factory run --record states` are packed")
    rows = dataset.metadata.select(["index", "file_sha256"]).to_pydict()
    with open_archive(site.state_dir, site.store) as archive:
        packed = pack_all(archive, dict(zip(rows["index"], rows["file_sha256"], strict=True)))
        shards, files = len(archive.shards()), len(archive.unpacked())
    if as_json:
        print_json({"dataset": str(site), "packed": packed, "shards": shards, "files": files})
    else:
        click.echo(f"{site}: {packed} episodes packed; {shards} shards and {files} single episode files")
