"""`factory replay`: simulates an archived episode again and compares the digests."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from factory.cli.options import episode_argument, json_option, place_argument, renderer_option

if TYPE_CHECKING:
    from factory.runs.replay import Replay
    from schemas.storage.place import Place
    from schemas.terms import RendererKind


@click.command("replay")
@place_argument
@episode_argument
@renderer_option
@json_option
def command(root: Place, episode: str, renderer: RendererKind, as_json: bool) -> int:
    """Simulate one episode again and compare its content.

    EPISODE is a name or number: ep_000001 or 1. Exits with 1 if the content differs.
    """
    from factory.dataset.episode_names import episode_path
    from factory.runs.replay import replay_episode
    from factory.support.logs import configure_logs
    from factory.support.terminal import one_bar, print_json

    configure_logs()
    path = episode_path(root, episode)
    with one_bar(f"replaying {path.stem}") as on_progress:
        outcome = replay_episode(root, path, renderer, on_progress)
    if as_json:
        print_json({**asdict(outcome), "identical": outcome.is_identical})
    else:
        _print(outcome)
    return 0 if outcome.is_identical else 1


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
