"""`factory pack`: packs the episodes of a states dataset into shards."""

from __future__ import annotations

import click

from coordinator.archive.opening import open_archive
from coordinator.packing import pack_all
from factory.commands.common.output import print_json
from factory.dataset.reader import Dataset
from factory.dataset.site import Site
from factory.support.logs import configure_logs
from schemas.errors import UsageError
from schemas.terms import Recording


def execute(site: Site, as_json: bool) -> None:
    """Executes `factory pack`."""
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
