"""`factory replay`: simulates an archived episode again and compares the digests."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.options import PLACE, complete_episode, json_option, renderer_option
from schemas.errors import UsageError
from schemas.storage.place import place_of

if TYPE_CHECKING:
    from factory.runs.replay import Replay
    from schemas.storage.place import Place
    from schemas.terms import RendererKind


@click.command("replay")
@click.argument("names", metavar="[DIR|URL] EPISODE", nargs=-1, shell_complete=complete_episode)
@click.option(
    "--from",
    "export",
    type=click.Path(path_type=Path, exists=True),
    metavar="EXPORT",
    help="Export of `factory export`, or one of its files, that states the origin of EPISODE; replaces DIR.",
)
@click.option(
    "--scenes",
    type=PLACE,
    metavar="DIR|URL",
    help="With --from: folder with the package of the scene, e.g. `scenes` of the dataset. Default: MINIVLA_SCENES, "
    "then the cache; built-in scenes are built.",
)
@renderer_option
@json_option
def command(
    names: tuple[str, ...], export: Path | None, scenes: Place | None, renderer: RendererKind, as_json: bool
) -> int:
    """Simulate one episode again and compare its content.

    EPISODE is a name or number: ep_000001 or 1. Without --from, DIR is the dataset and all content is compared; with
    --from, the states (actions, poses and metadata) are compared with the digest in the export, and the dataset
    is not needed. Exits with 1 if the content differs.
    """
    from factory.support.logs import configure_logs
    from factory.support.terminal import print_json

    configure_logs()
    if len(names) != (2 if export is None else 1):
        raise UsageError("give DIR EPISODE, or --from EXPORT EPISODE")
    if export is None and scenes is not None:
        raise UsageError("--scenes needs --from: a dataset contains the packages of its scenes")
    if export is None:
        outcome = _from_dataset(place_of(names[0]), names[1], renderer)
    else:
        outcome = _from_export(export, names[0], scenes, renderer)
    if as_json:
        print_json({**asdict(outcome), "identical": outcome.is_identical})
    else:
        _print(outcome)
    return 0 if outcome.is_identical else 1


def _from_dataset(root: Place, episode: str, renderer: RendererKind) -> Replay:
    from factory.dataset.episode_names import episode_path
    from factory.runs.replay import replay_episode
    from factory.support.terminal import one_bar

    path = episode_path(root, episode)
    with one_bar(f"replaying {path.stem}") as on_progress:
        return replay_episode(root, path, renderer, on_progress)


def _from_export(export: Path, episode: str, scenes: Place | None, renderer: RendererKind) -> Replay:
    from factory.export.origin import find_origin
    from factory.runs.replay import replay_origin
    from factory.runs.scene_packages import package_of_origin
    from factory.support.terminal import one_bar

    origin = find_origin(export, episode)
    package = package_of_origin(origin, scenes)
    with one_bar(f"replaying {origin.episode}") as on_progress:
        return replay_origin(origin, package, renderer, on_progress)


def _print(outcome: Replay) -> None:
    if outcome.is_identical:
        click.echo(f"{outcome.episode_id}: identical, {outcome.steps} steps, digest {outcome.archived_digest}")
    else:
        click.echo(f"{outcome.episode_id}: differs")
        click.echo(f"  archived {outcome.archived_digest}\n  replayed {outcome.replayed_digest}")
        for name, distance in outcome.differences.items():
            click.echo(f"  {name}: largest difference {distance:g}")
    for name, (then, now) in outcome.fingerprint_changes.items():
        click.echo(f"  {name}: {then} when archived, {now} on this machine")
