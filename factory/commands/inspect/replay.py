"""`factory replay`: simulates an archived episode again and compares the digests."""

from __future__ import annotations

from dataclasses import asdict

import click

from factory.commands.common.bars import one_bar
from factory.commands.common.episode_names import episode_path
from factory.commands.common.output import print_json
from factory.runs.replay import Replay, replay_episode
from factory.support.logs import configure_logs
from schemas.storage.place import Place
from schemas.terms import RendererKind


def execute(root: Place, episode: str, renderer: RendererKind, as_json: bool) -> int:
    """Executes `factory replay`."""
    configure_logs()
    path = episode_path(root, episode)
    with one_bar(f"replaying {path.stem}") as tell:
        outcome = replay_episode(root, path, renderer, tell)
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
