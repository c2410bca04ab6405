"""`factory jobs`: lists, shows, retries and cancels jobs; releases hosts; pauses and resumes a run; drains workers."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import click

from coordinator.ledger.states import JobState
from factory.cli.groups import CommandGroup
from factory.cli.options import (
    Command,
    collected,
    connect_option,
    count_option,
    episode_argument,
    filter_option,
    json_option,
    ledger_option,
    scene_filter,
    site_argument,
    split_filter,
    tier_filter,
    tls_option,
)
from schemas.errors import UsageError
from schemas.terms import Split, Tier

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from coordinator.ledger.reading.records import JobRecord
    from factory.dataset.site import Site
    from schemas.protocol.administration import AdminAction, AdminReply, AdminRequest


@dataclass(frozen=True)
class Reach:
    """How an admin request reaches a run. A field has the name of the parameter of its option."""

    ledger: str | None = None
    """URL of the ledger; `None` for the ledger of the dataset."""
    connect: tuple[str, ...] = ()
    """Endpoints of the running coordinator; empty uses those that it has recorded in DIR."""
    tls: Path | None = None
    """TLS folder of this host."""


def admin_options(command: Command) -> Command:
    """Adds `--ledger --connect --tls` as `reach`."""
    command = collected(command, "reach", Reach)
    for option in (
        tls_option,
        connect_option(
            "Endpoint of the running coordinator, e.g. tls/hub:7447; repeatable. DIR is then not read, and can be `-`. "
            "Default: the endpoints that the coordinator recorded in DIR, loopback first."
        ),
        ledger_option,
    ):
        command = option(command)
    return command


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
def list_(
    site: Site,
    states: tuple[str, ...] | None,
    scenes: tuple[str, ...] | None,
    tiers: tuple[str, ...] | None,
    splits: tuple[str, ...] | None,
    limit: int,
    ledger: str | None,
    as_json: bool,
) -> None:
    """List the current job of each episode of a run.

    An episode gets a new job, called a draw, with another target when its job fails too often.
    """
    from coordinator.expansion.plan_file import scenes_named
    from coordinator.ledger.opening import read_info
    from coordinator.ledger.reading.records import JobFilter, count_jobs, list_jobs
    from factory.runs.ledger import read_ledger
    from factory.support.terminal import print_json, print_table

    with read_ledger(site, ledger) as connection:
        plan = read_info(connection).plan if scenes else None
        selection = JobFilter(
            states=tuple(map(JobState, states or ())),
            scenes=() if plan is None else tuple(name for given in scenes or () for name in scenes_named(plan, given)),
            tiers=tuple(map(Tier, tiers or ())),
            splits=tuple(map(Split, splits or ())),
        )
        jobs, total = list_jobs(connection, selection, limit), count_jobs(connection, selection)
    if as_json:
        print_json({"total": total, "jobs": [_plain(job) for job in jobs]})
        return
    columns = ("episode", "state", "scene", "tier", "split", "target", "attempt", "draw", "reason")
    print_table("", columns, map(_row_of, jobs))
    if total > len(jobs):
        click.echo(f"{len(jobs)} of {total} jobs are listed; list more with --limit", err=True)


@command.command("show")
@site_argument
@episode_argument
@ledger_option
@json_option
def show(site: Site, episode: str, ledger: str | None, as_json: bool) -> None:
    """Show the draws, attempts and events of one episode.

    EPISODE is a name or number: ep_000001 or 1.
    """
    from coordinator.ledger.reading.records import JobFilter, list_jobs, read_attempts, read_events
    from factory.dataset.episode_names import episode_index
    from factory.runs.ledger import read_ledger
    from factory.support.terminal import print_json, print_table, print_text
    from schemas.job import episode_id

    index = episode_index(episode)
    with read_ledger(site, ledger) as connection:
        draws = list_jobs(connection, JobFilter(index=index))
        attempts, events = list(read_attempts(connection, index)), list(read_events(connection, index))
    if not draws:
        raise UsageError(
            f"the run in {site} has no episode {episode_id(index)}; list its episodes with `factory jobs list`"
        )
    if as_json:
        parts: dict[str, Sequence[object]] = {"draws": draws, "attempts": attempts, "events": events}
        print_json({name: [_plain(record) for record in records] for name, records in parts.items()})
        return
    last = draws[-1]
    spec = f"{last.episode.scene}, {last.episode.split}, {last.episode.tier}: {last.episode.instruction}"
    print_text(f"{episode_id(index)}: {last.state}; {spec}")
    rows = [(d.draw, d.state, d.episode.category, d.episode.target_id, d.misses, d.crashes, d.reason) for d in draws]
    print_table("draws", ("draw", "state", "category", "target", "misses", "crashes", "reason"), rows)
    print_table(
        "attempts",
        ("attempt", "draw", "outcome", "steps", "seconds", "worker", "detail"),
        [(a.attempt, a.draw, a.outcome, a.steps, a.seconds or None, a.worker, a.detail) for a in attempts],
    )
    print_table(
        "events",
        ("at", "draw", "attempt", "event", "state", "worker", "detail"),
        [(f"{e.at:%H:%M:%S}", e.draw, e.attempt, e.event, e.state, e.worker, e.detail) for e in events],
    )


@command.command("retry")
@site_argument
@click.argument("episodes", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Retry all failed jobs of the run.")
@admin_options
@json_option
def retry(site: Site, episodes: tuple[str, ...], everything: bool, reach: Reach, as_json: bool) -> int:
    """Put failed or cancelled jobs back into the queue.

    EPISODES are names or numbers: ep_000001 or 1. Each job gets as many attempts as a new job.
    """
    from schemas.protocol.administration import AdminAction

    return _administer(site, AdminAction.RETRY, episodes, everything, reach=reach, as_json=as_json)


@command.command("cancel")
@site_argument
@click.argument("episodes", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Cancel all jobs of the run that have not finished.")
@admin_options
@json_option
def cancel(site: Site, episodes: tuple[str, ...], everything: bool, reach: Reach, as_json: bool) -> int:
    """Cancel jobs that have not finished.

    EPISODES are names or numbers: ep_000001 or 1. A worker stops a cancelled job at its next heartbeat.
    """
    from schemas.protocol.administration import AdminAction

    return _administer(site, AdminAction.CANCEL, episodes, everything, reach=reach, as_json=as_json)


@command.command("release")
@site_argument
@click.argument("hosts", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Release all barred and limited hosts.")
@admin_options
@json_option
def release(site: Site, hosts: tuple[str, ...], everything: bool, reach: Reach, as_json: bool) -> int:
    """Allow barred or limited HOSTS to receive jobs again.

    HOSTS are host names as printed by `factory status`. A host is limited to one job at a time, then barred,
    when its attempts keep failing because of the host.
    """
    from factory.support.terminal import print_json
    from schemas.protocol.administration import AdminAction, AdminRequest
    from schemas.protocol.identity import require_host_name

    if bool(hosts) == everything:
        raise UsageError("give either HOSTS, as `factory status` prints them, or --all")
    request = AdminRequest(action=AdminAction.RELEASE, hosts=tuple(require_host_name(name) for name in hosts))
    reply = _ask(site, request, reach)
    if as_json:
        print_json(reply.model_dump(mode="json"))
    else:
        click.echo(f"released {len(reply.hosts)} hosts: {', '.join(reply.hosts) or 'none'}")
        for host, reason in reply.refused_hosts.items():
            click.echo(f"  {host}: {reason}", err=True)
    return 1 if reply.refused_hosts else 0


@command.command("pause")
@site_argument
@admin_options
@json_option
def pause(site: Site, reach: Reach, as_json: bool) -> None:
    """Lease no more jobs until the run is resumed.

    Running jobs continue. The pause survives a restart of the coordinator.
    """
    from schemas.protocol.administration import AdminAction

    _switch(site, AdminAction.PAUSE, f"paused {site}", reach=reach, as_json=as_json)


@command.command("resume")
@site_argument
@admin_options
@json_option
def resume(site: Site, reach: Reach, as_json: bool) -> None:
    """Lease jobs of a paused run again."""
    from schemas.protocol.administration import AdminAction

    _switch(site, AdminAction.RESUME, f"resumed {site}", reach=reach, as_json=as_json)


@command.command("drain")
@site_argument
@admin_options
@json_option
def drain(site: Site, reach: Reach, as_json: bool) -> None:
    """Let every worker finish its current jobs and exit.

    Workers that are started later exit, too, until the coordinator is restarted.
    """
    from schemas.protocol.administration import AdminAction

    effect = f"the workers of {site} finish their current jobs and exit"
    _switch(site, AdminAction.DRAIN, effect, reach=reach, as_json=as_json)


def _switch(site: Site, action: AdminAction, effect: str, *, reach: Reach, as_json: bool) -> None:
    from factory.support.terminal import print_result, print_text
    from schemas.protocol.administration import AdminRequest

    reply = _ask(site, AdminRequest(action=action), reach)
    print_result(reply, as_json, lambda _: print_text(effect))


def _administer(
    site: Site,
    action: AdminAction,
    names: tuple[str, ...],
    everything: bool,
    *,
    reach: Reach,
    as_json: bool,
) -> int:
    from factory.dataset.episode_names import episode_index
    from factory.support.terminal import print_result
    from schemas.protocol.administration import MAX_INDICES, AdminRequest

    if bool(names) == everything:
        raise UsageError(f"give either EPISODES or --all to {action} jobs")
    if len(names) > MAX_INDICES:
        raise UsageError(f"{len(names)} episodes were given; give at most {MAX_INDICES}, or --all")
    request = AdminRequest(action=action, indices=tuple(episode_index(name) for name in names))
    reply = _ask(site, request, reach)
    print_result(reply, as_json, lambda reply: _print_reply(reply, action))
    return 1 if reply.refused else 0


def _ask(site: Site, request: AdminRequest, reach: Reach) -> AdminReply:
    from coordinator.admin import administer
    from coordinator.protocol.tls import read_credentials
    from factory.support.listen import require_endpoints

    require_endpoints(reach.connect, with_tls=reach.tls is not None)
    more: dict[str, Any] = {}
    if reach.tls is not None:
        more["tls"], more["name"] = read_credentials(reach.tls)
    return administer(site.state_dir, request, datetime.now(UTC), reach.ledger, connect=reach.connect, **more)


def _print_reply(reply: AdminReply, action: AdminAction) -> None:
    from factory.support.terminal import print_text
    from schemas.job import episode_id

    shown = ", ".join(episode_id(index) for index in reply.changed[:20])
    more = f" and {len(reply.changed) - 20} more" if len(reply.changed) > 20 else ""
    print_text(f"{action}: {len(reply.changed)} jobs {shown}{more}")
    for index, reason in reply.refused.items():
        click.echo(f"  {episode_id(index)}: {reason}", err=True)


def _row_of(job: JobRecord) -> tuple[object, ...]:
    from schemas.job import episode_id

    spec = job.episode
    place = spec.scene, spec.tier, spec.split, spec.target_id
    return episode_id(job.index), job.state, *place, job.attempt, job.draw, job.reason


def _plain(record: object) -> dict[str, Any]:
    """Returns a record as flat JSON values, with the fields of its episode spec at the top level."""
    from schemas.episode_spec import EpisodeSpec

    plain: dict[str, Any] = {}
    for name, value in vars(record).items():
        plain |= dict(value) if isinstance(value, EpisodeSpec) else {name: value}
    return {name: value.isoformat() if isinstance(value, datetime) else value for name, value in plain.items()}
