"""Hostile peers in the role of gateways: the coordinator stays up, honest workers continue, no episode is lost."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from coordinator.expansion.draw import to_job
from coordinator.ledger.archived import count_by_gateway
from coordinator.ledger.opening import ledger_url_of, planned_of
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.tables import jobs
from coordinator.options import CoordinatorOptions
from coordinator.protocol.protocol import ParsedRequest, Terms
from coordinator.protocol.relay import (
    MAX_FILES,
    MAX_LOST,
    Archived,
    ExtendLease,
    Inventory,
    InventoryReply,
    Join,
    JoinReply,
    Refused,
)
from coordinator.protocol.relay_handlers import serve_gateway
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from schemas.base import MAX_COUNT
from schemas.dataset.rows import EpisodeSummary, summary_of
from schemas.protocol.keys import Verb
from schemas.protocol.messages import Ack, Lease, Refusal
from schemas.support.product import product_version
from tests.builders.bundle import job_for, parts_for
from tests.builders.ledger import TTL_S, TimedLedger, room_catalog, room_plan
from tests.builders.shared_validator import SharedValidator
from tests.builders.wire_worker import WireWorker, bundle_for, until

ANY_PORT = ("tcp/127.0.0.1:0",)
SETTINGS = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0)
EPISODES = 6
STRANGE = Lease(job_id=1, fence=1, token="0" * 32)
NOBODYS = dict.fromkeys(range(1, MAX_FILES + 1), 7)


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    is_server = request.param == "postgresql"
    server = request.getfixturevalue("postgres_server") if is_server else None
    return server.new_database() if server is not None else ledger_url_of(tmp_path / "out")


@pytest.fixture
def hub(url: str, tmp_path: Path, checker: SharedValidator) -> Iterator[Coordinator]:
    (tmp_path / "out").mkdir()
    catalog = room_catalog(tmp_path)
    with Coordinator(
        tmp_path / "out",
        room_plan(EPISODES),
        catalog,
        CoordinatorOptions(listen=ANY_PORT, ledger_url=url, settings=SETTINGS, checker=checker),
    ) as running:
        yield running
    assert ledger_trouble(url, catalog) == ""


def message_about(summary: EpisodeSummary, lease: Lease | None = None) -> Archived:
    return Archived(summary=summary, lease=lease)


def attack(peer: WireWorker, number: int) -> list[Any]:
    """Sends a false gateway message of each kind; returns the replies."""
    foreign = summary_of(parts_for(job_for(1 + number % EPISODES)).meta, "1" * 64, 7)
    messages = (
        (Verb.JOIN, Join(version=product_version(), router=f"{number:x}"), JoinReply),
        (Verb.HOLD, ExtendLease(lease=STRANGE, seconds=600.0), Ack),
        (Verb.REFUSED, Refused(sid="good.1", lease=STRANGE, detail="x" * 2000), Ack),
        (Verb.ARCHIVED, message_about(foreign.model_copy(update={"run": "other"})), Ack),
        (Verb.ARCHIVED, message_about(foreign.model_copy(update={"plan_digest": "2" * 64}), STRANGE), Ack),
        (Verb.INVENTORY, Inventory(first=1, last=MAX_COUNT, files=tuple(NOBODYS.items())), InventoryReply),
        (Verb.INVENTORY, Inventory(first=1, last=MAX_COUNT, files=()), InventoryReply),
        (Verb.INVENTORY, b'{"first": 1, "last": 1, "files": [' + b"[1, 1]," * 9000 + b"[1, 1]]}", InventoryReply),
    )
    return [peer.ask(verb, message, reply) for verb, message, reply in messages]


def test_a_hostile_gateway_cannot_affect_honest_workers(hub: Coordinator) -> None:
    stop, rounds = threading.Event(), []

    def disturb(name: str) -> None:
        with WireWorker(hub.endpoints, hub.run, name) as peer:
            while not stop.is_set():
                rounds.append(attack(peer, len(rounds)))

    peers = [threading.Thread(target=disturb, args=(f"gw-{number}",)) for number in range(2)]
    for thread in peers:
        thread.start()
    try:
        until(lambda: len(rounds) >= 2, 60)
        with WireWorker(hub.endpoints, hub.run, "good") as good:

            def is_finished() -> bool:
                reply = good.claim()
                if reply.job is not None and reply.lease is not None:
                    good.deliver(reply.lease, bundle_for(reply.job))
                good.beat()
                return hub.is_finished()

            until(is_finished, 120)
        done = len(rounds)
        until(lambda: len(rounds) >= done + 4, 60)
    finally:
        stop.set()
        for thread in peers:
            thread.join()
    progress = hub.progress()
    assert (progress.jobs["archived"], progress.by_gateway, progress.hosts) == (EPISODES, {}, ())
    accepted = [reply for replies in rounds for reply in replies if reply == Ack(accepted=True)]
    assert accepted == []
    assert all(reply.lost == () for replies in rounds for reply in replies if isinstance(reply, InventoryReply))


class Core:
    """Handles gateway requests as the coordinator does, with a ledger in memory."""

    def __init__(self, episodes: int) -> None:
        self.timed_ledger = TimedLedger(room_plan(episodes))
        self.terms = Terms(self.timed_ledger.plan, self.timed_ledger.catalog, "1", TTL_S, 0.1)

    def ask(self, message: Any, gateway: str = "gw") -> Any:
        with self.timed_ledger.open() as connection:
            return serve_gateway(connection, ParsedRequest(gateway, message), self.terms, self.timed_ledger.now).reply

    def summaries(self) -> dict[int, EpisodeSummary]:
        """Returns the table row that a gateway would report for each episode of the plan, by index."""
        with self.timed_ledger.open() as connection:
            rows = connection.execute(select(jobs)).all()
        meta = parts_for().meta
        found = {}
        for row in rows:
            job = to_job(self.timed_ledger.plan, self.timed_ledger.catalog, planned_of(row), 1)
            meta = meta.model_copy(update={"job": job, "episode_id": job.episode_id})
            found[row.idx] = summary_of(meta, "1" * 64, 7)
        return found

    def kept(self) -> int:
        with self.timed_ledger.open() as connection:
            return count_by_gateway(connection).get("gw", 0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *(("run", "other"), ("plan_digest", "2" * 64), ("scene_sha256", "2" * 64), ("attempt", MAX_COUNT)),
        *(("split", "test_id"), ("target_id", "chair_999"), ("file_name", "../../etc/passwd"), ("instruction", "x")),
    ],
)
def test_an_episode_of_another_run_is_refused_with_the_field_name(field: str, value: Any) -> None:
    core = Core(1)
    true = core.summaries()[1]
    false = EpisodeSummary.model_validate(true.model_dump() | {field: value})
    reply = core.ask(message_about(false))
    assert isinstance(reply, Refusal)
    assert field in reply.error
    assert core.timed_ledger.rows()[0].state == "pending"
    assert core.ask(message_about(true)) == Ack(accepted=True)


def test_an_unknown_draw_is_refused() -> None:
    core = Core(1)
    later = core.summaries()[1].model_copy(update={"draw": 3})
    assert core.ask(message_about(later)) == Ack(accepted=False)


def test_inventories_are_served_in_bounded_steps_until_all_lost_episodes_are_queued_again() -> None:
    core = Core(MAX_LOST + 200)
    for summary in core.summaries().values():
        assert core.ask(message_about(summary)) == Ack(accepted=True)
    first, last = 1, MAX_LOST + 100
    sizes = dict.fromkeys(range(last + 1, MAX_LOST + 201), 7)
    told = Inventory(first=first, last=MAX_COUNT, files=tuple(sizes.items()))
    reply = core.ask(told)
    assert (len(reply.lost), reply.strays) == (MAX_LOST, ())
    reply = core.ask(told)
    assert reply.lost == tuple(range(MAX_LOST + 1, last + 1))
    assert reply.strays == ()
    assert core.kept() == len(sizes)


def test_a_file_outside_the_range_of_its_inventory_is_ignored() -> None:
    core = Core(3)
    for summary in core.summaries().values():
        core.ask(message_about(summary))
    reply = core.ask(Inventory(first=1, last=1, files=((1, 7), (2, 8), (3, 9))))
    assert (reply.strays, reply.lost) == ((), ())
    assert core.kept() == 3


def test_a_gateway_cannot_release_episodes_of_another_gateway() -> None:
    core = Core(2)
    for summary in core.summaries().values():
        core.ask(message_about(summary))
    assert core.ask(Inventory(first=1, last=MAX_COUNT, files=()), "other").lost == ()
    assert core.kept() == 2
