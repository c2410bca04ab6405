"""`factory jobs`: lists, shows, retries and cancels jobs; releases hosts; pauses and resumes a run; drains workers."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import click

from coordinator.expansion.plan_file import scene_of
from coordinator.ledger.opening import read_info
from coordinator.ledger.reading.records import JobFilter, JobRecord, count_jobs, list_jobs, read_attempts, read_events
from coordinator.ledger.states import JobState
from coordinator.protocol.tls import read_credentials
from factory.commands.common.episode_names import episode_index
from factory.commands.common.output import print_json, print_result, print_table, print_text
from factory.dataset.site import Site
from factory.runs.ledger import read_ledger
from schemas.episode_spec import EpisodeSpec
from schemas.errors import UsageError
from schemas.job import episode_id
from schemas.protocol.administration import MAX_INDICES, AdminAction, AdminReply, AdminRequest
from schemas.protocol.identity import require_host_name
from schemas.terms import Split, Tier


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
    """Executes `factory jobs list`."""
    wanted = JobFilter(
        states=tuple(map(JobState, states or ())),
        scenes=scenes or (),
        tiers=tuple(map(Tier, tiers or ())),
        splits=tuple(map(Split, splits or ())),
    )
    with read_ledger(site, ledger) as connection:
        for scene in wanted.scenes:
            scene_of(read_info(connection).plan, scene)
        jobs, total = list_jobs(connection, wanted, limit), count_jobs(connection, wanted)
    if as_json:
        print_json({"total": total, "jobs": [_plain(job) for job in jobs]})
        return
    columns = ("episode", "state", "scene", "tier", "split", "target", "attempt", "draw", "reason")
    print_table("", columns, map(_row_of, jobs))
    if total > len(jobs):
        click.echo(f"{len(jobs)} of {total} jobs are listed; list more with --limit", err=True)


def show(site: Site, episode: str, ledger: str | None, as_json: bool) -> None:
    """Executes `factory jobs show`."""
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
    print_text(f"{episode_id(index)}: {last.state}; {_describe_spec(last.episode)}")
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


def retry(
    site: Site, episodes: tuple[str, ...], everything: bool, ledger: str | None, tls: Path | None, as_json: bool
) -> int:
    """Executes `factory jobs retry`."""
    return _administer(site, AdminAction.RETRY, episodes, everything, ledger, tls, as_json)


def cancel(
    site: Site, episodes: tuple[str, ...], everything: bool, ledger: str | None, tls: Path | None, as_json: bool
) -> int:
    """Executes `factory jobs cancel`."""
    return _administer(site, AdminAction.CANCEL, episodes, everything, ledger, tls, as_json)


def release(
    site: Site, hosts: tuple[str, ...], everything: bool, ledger: str | None, tls: Path | None, as_json: bool
) -> int:
    """Executes `factory jobs release`."""
    if bool(hosts) == everything:
        raise UsageError("give either HOSTS, as `factory status` prints them, or --all")
    request = AdminRequest(action=AdminAction.RELEASE, hosts=tuple(require_host_name(name) for name in hosts))
    reply = _ask(site, request, ledger, tls)
    if as_json:
        print_json(reply.model_dump(mode="json"))
    else:
        click.echo(f"released {len(reply.hosts)} hosts: {', '.join(reply.hosts) or 'none'}")
        for host, reason in reply.refused_hosts.items():
            click.echo(f"  {host}: {reason}", err=True)
    return 1 if reply.refused_hosts else 0


def pause(site: Site, ledger: str | None, tls: Path | None, as_json: bool) -> None:
    """Executes `factory jobs pause`."""
    _switch(site, AdminAction.PAUSE, f"paused {site}", ledger, tls, as_json)


def resume(site: Site, ledger: str | None, tls: Path | None, as_json: bool) -> None:
    """Executes `factory jobs resume`."""
    _switch(site, AdminAction.RESUME, f"resumed {site}", ledger, tls, as_json)


def drain(site: Site, ledger: str | None, tls: Path | None, as_json: bool) -> None:
    """Executes `factory jobs drain`."""
    _switch(site, AdminAction.DRAIN, f"the workers of {site} finish their current jobs and exit", ledger, tls, as_json)


def _switch(site: Site, action: AdminAction, effect: str, ledger: str | None, tls: Path | None, as_json: bool) -> None:
    reply = _ask(site, AdminRequest(action=action), ledger, tls)
    print_result(reply, as_json, lambda _: print_text(effect))


def _administer(
    site: Site,
    action: AdminAction,
    names: tuple[str, ...],
    everything: bool,
    ledger: str | None,
    tls: Path | None,
    as_json: bool,
) -> int:
    if bool(names) == everything:
        raise UsageError(f"give either EPISODES or --all to {action} jobs")
    if len(names) > MAX_INDICES:
        raise UsageError(f"{len(names)} episodes were given; give at most {MAX_INDICES}, or --all")
    request = AdminRequest(action=action, indices=tuple(episode_index(name) for name in names))
    reply = _ask(site, request, ledger, tls)
    print_result(reply, as_json, partial(_print_reply, action=action))
    return 1 if reply.refused else 0


def _ask(site: Site, request: AdminRequest, ledger: str | None, tls: Path | None) -> AdminReply:
    from coordinator.admin import administer  # imports zenoh

    now = datetime.now(UTC)
    if tls is None:
        return administer(site.state_dir, request, now, ledger)
    files, name = read_credentials(tls)
    return administer(site.state_dir, request, now, ledger, name=name, tls=files)


def _print_reply(reply: AdminReply, action: AdminAction) -> None:
    shown = ", ".join(episode_id(index) for index in reply.changed[:20])
    more = f" and {len(reply.changed) - 20} more" if len(reply.changed) > 20 else ""
    print_text(f"{action}: {len(reply.changed)} jobs {shown}{more}")
    for index, reason in reply.refused.items():
        click.echo(f"  {episode_id(index)}: {reason}", err=True)


def _row_of(job: JobRecord) -> tuple[object, ...]:
    asked = job.episode
    place = asked.scene, asked.tier, asked.split, asked.target_id
    return episode_id(job.index), job.state, *place, job.attempt, job.draw, job.reason


def _describe_spec(episode: EpisodeSpec) -> str:
    return f"{episode.scene}, {episode.split}, {episode.tier}: {episode.instruction}"


def _plain(record: object) -> dict[str, Any]:
    """Returns a record as flat JSON values, with the fields of its episode spec at the top level."""
    plain: dict[str, Any] = {}
    for name, value in vars(record).items():
        plain |= dict(value) if isinstance(value, EpisodeSpec) else {name: value}
    return {name: value.isoformat() if isinstance(value, datetime) else value for name, value in plain.items()}
