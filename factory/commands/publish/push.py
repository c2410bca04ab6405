"""`factory push`: uploads a dataset or an export to the Hugging Face Hub."""

from __future__ import annotations

from pathlib import Path

import click
from rich.progress import DownloadColumn, TimeRemainingColumn

from factory.commands.common.bars import Bars, one_bar
from factory.commands.common.output import print_json, print_table
from factory.export.execution.manifest import MANIFEST_FILE
from factory.push import PushPlan, plan_push, push
from factory.push.files import batches_of, require_repository
from factory.push.thumbnails import lacks_thumbnails, render_thumbnails


def execute(
    root: Path, repository: str, private: bool, endpoint: str | None, thumbnails: bool, dry_run: bool, as_json: bool
) -> None:
    """Executes `factory push`."""
    require_repository(repository)
    if lacks_thumbnails(root):
        if thumbnails and not dry_run:
            with one_bar("rendering thumbnails") as tell:
                render_thumbnails(root, tell)
        else:
            click.echo("note: the dataset has no thumbnails for the Hub's viewer; --thumbnails renders them", err=True)
    plan = plan_push(root, MANIFEST_FILE)
    for remark in plan.remarks:
        click.echo(f"note: {remark}", err=True)
    if dry_run:
        _show_plan(plan, repository, as_json)
        return
    click.echo(f"uploading {len(plan.files)} files, {_say_bytes(plan.total_bytes)}, to {repository}", err=True)
    with Bars(DownloadColumn(), TimeRemainingColumn()) as progress:
        task = progress.add_task(repository, total=plan.total_bytes)
        result = push(plan, repository, endpoint, private, lambda _, size: progress.advance(task, size))
    if as_json:
        print_json(result._asdict())
        return
    tagged = f", tagged {result.tag}" if result.tag else ""
    click.echo(f"{result.url}: {result.files} files, {_say_bytes(result.total_bytes)}{tagged}")


def _show_plan(plan: PushPlan, repository: str, as_json: bool) -> None:
    folders: dict[str, list[int]] = {}
    for file in plan.files:
        folders.setdefault(file.name.rpartition("/")[0] or ".", []).append(file.size)
    commits = len(list(batches_of(plan.files)))
    if as_json:
        print_json(
            {
                "repository": repository,
                "kind": plan.kind,
                "files": len(plan.files),
                "total_bytes": plan.total_bytes,
                "commits": commits,
                "tag": plan.tag,
                "folders": {name: {"files": len(sizes), "bytes": sum(sizes)} for name, sizes in folders.items()},
                "remarks": list(plan.remarks),
            }
        )
        return
    rows = [(name, len(sizes), _say_bytes(sum(sizes))) for name, sizes in folders.items()]
    print_table(f"{plan.kind} {plan.root} to {repository}", ("folder", "files", "size"), rows)
    tagged = f", tag {plan.tag}" if plan.tag else ""
    click.echo(
        f"{len(plan.files)} files, {_say_bytes(plan.total_bytes)}, {commits} commits{tagged}; nothing was uploaded"
    )


def _say_bytes(count: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count} B"
