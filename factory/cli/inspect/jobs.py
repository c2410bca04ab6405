"""Declares `factory jobs`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from coordinator.ledger.states import JobState
from factory.cli.common.filters import filter_option, scene_filter, split_filter, tier_filter
from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import count_option, json_option, ledger_option, site_argument, tls_option


@click.group("jobs", cls=CommandGroup)
def command() -> None:
    """List, retry and cancel jobs; release hosts; pause a run."""


@command.command("list")
@site_argument
@filter_option("--state", "states", JobState)
@scene_filter()
@tier_filter()
@split_filter()
@count_option("--limit", 100, "Maximum number of rows.")
@ledger_option
@json_option
def list_(**options: Any) -> None:
    """List the current job of each episode of a run.

    An episode gets a new job, called a draw, with another target when its job fails too often.
    """
    from factory.commands.inspect.jobs import list_

    list_(**options)


@command.command("show")
@site_argument
@click.argument("episode")
@ledger_option
@json_option
def show(**options: Any) -> None:
    """Show the draws, attempts and events of one episode.

    EPISODE is a name or number: ep_000001 or 1.
    """
    from factory.commands.inspect.jobs import show

    show(**options)


@command.command("retry")
@site_argument
@click.argument("episodes", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Retry all failed jobs of the run.")
@ledger_option
@tls_option
@json_option
def retry(**options: Any) -> int:
    """Put failed or cancelled jobs back into the queue.

    EPISODES are names or numbers: ep_000001 or 1. Each job gets as many attempts as a new job.
    """
    from factory.commands.inspect.jobs import retry

    return retry(**options)


@command.command("cancel")
@site_argument
@click.argument("episodes", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Cancel all jobs of the run that have not finished.")
@ledger_option
@tls_option
@json_option
def cancel(**options: Any) -> int:
    """Cancel jobs that have not finished.

    EPISODES are names or numbers: ep_000001 or 1. A worker stops a cancelled job at its next heartbeat.
    """
    from factory.commands.inspect.jobs import cancel

    return cancel(**options)


@command.command("release")
@site_argument
@click.argument("hosts", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Release all barred and limited hosts.")
@ledger_option
@tls_option
@json_option
def release(**options: Any) -> int:
    """Allow barred or limited HOSTS to receive jobs again.

    HOSTS are host names as printed by `factory status`. A host is limited to one job at a time, then barred,
    when its attempts keep failing because of the host.
    """
    from factory.commands.inspect.jobs import release

    return release(**options)


@command.command("pause")
@site_argument
@ledger_option
@tls_option
@json_option
def pause(**options: Any) -> None:
    """Lease no more jobs until the run is resumed.

    Running jobs continue. The pause survives a restart of the coordinator.
    """
    from factory.commands.inspect.jobs import pause

    pause(**options)


@command.command("resume")
@site_argument
@ledger_option
@tls_option
@json_option
def resume(**options: Any) -> None:
    """Lease jobs of a paused run again."""
    from factory.commands.inspect.jobs import resume

    resume(**options)


@command.command("drain")
@site_argument
@ledger_option
@tls_option
@json_option
def drain(**options: Any) -> None:
    """Let every worker finish its current jobs and exit.

    Workers that are started later exit, too, until the coordinator is restarted.
    """
    from factory.commands.inspect.jobs import drain

    drain(**options)
