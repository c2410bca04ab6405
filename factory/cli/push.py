"""`factory push`: uploads a dataset or an export to the Hugging Face Hub."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import dataset_argument, json_option

if TYPE_CHECKING:
    from factory.push import PushPlan


@click.command("push")
@dataset_argument
@click.argument("repository", metavar="OWNER/NAME")
@click.option("--private", is_flag=True, help="If the repository does not exist, create it as private.")
@click.option("--endpoint", metavar="URL", help="URL of the Hub. Default: HF_ENDPOINT, else https://huggingface.co.")
@click.option(
    "--thumbnails",
    is_flag=True,
    help="Render the missing thumbnails of a dataset of states into its tables, for the Hub's viewer. Needs the extra "
    "`render`.",
)
@click.option("--dry-run", is_flag=True, help="Print what would be uploaded, without network access.")
@json_option
def command(
    root: Path, repository: str, private: bool, endpoint: str | None, thumbnails: bool, dry_run: bool, as_json: bool
) -> None:
    """Upload a dataset or an export to the Hugging Face Hub.

    DIR is a dataset or the output of `factory export`. OWNER/NAME is a dataset repository.
    Log in with `hf auth login`, or set HF_TOKEN to a token with write access.
    The same command continues an interrupted upload.
    """
    from rich.progress import DownloadColumn, TimeRemainingColumn

    from factory.export.execution.manifest import MANIFEST_FILE
    from factory.push import plan_push, push
    from factory.push.files import lacks_thumbnails, render_thumbnails, require_repository
    from factory.support.terminal import Bars, one_bar, print_json

    require_repository(repository)
    if lacks_thumbnails(root):
        if thumbnails and not dry_run:
            with one_bar("rendering thumbnails") as on_progress:
                render_thumbnails(root, on_progress)
        else:
            click.echo("note: the dataset has no thumbnails for the Hub's viewer; --thumbnails renders them", err=True)
    plan = plan_push(root, MANIFEST_FILE)
    for remark in plan.remarks:
        click.echo(f"note: {remark}", err=True)
    if dry_run:
        _print_plan(plan, repository, as_json)
        return
    click.echo(f"uploading {len(plan.files)} files, {_format_bytes(plan.total_bytes)}, to {repository}", err=True)
    with Bars(DownloadColumn(), TimeRemainingColumn()) as progress:
        task = progress.add_task(repository, total=plan.total_bytes)
        result = push(
            plan, repository, endpoint=endpoint, private=private, tell=lambda _, size: progress.advance(task, size)
        )
    if as_json:
        print_json(result._asdict())
        return
    tagged = f", tagged {result.tag}" if result.tag else ""
    click.echo(f"{result.url}: {result.files} files, {_format_bytes(result.total_bytes)}{tagged}")


def _print_plan(plan: PushPlan, repository: str, as_json: bool) -> None:
    from factory.push.files import batches_of
    from factory.support.terminal import print_json, print_table

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
    rows = [(name, len(sizes), _format_bytes(sum(sizes))) for name, sizes in folders.items()]
    print_table(f"{plan.kind} {plan.root} to {repository}", ("folder", "files", "size"), rows)
    tagged = f", tag {plan.tag}" if plan.tag else ""
    click.echo(
        f"{len(plan.files)} files, {_format_bytes(plan.total_bytes)}, {commits} commits{tagged}; nothing was uploaded"
    )


def _format_bytes(count: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.1f} {unit}"
    return f"{count} B"
