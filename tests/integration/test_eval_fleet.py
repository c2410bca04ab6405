"""An evaluation that joins a running collection: workers run the evaluation first and then resume the collection."""

from __future__ import annotations

import dataclasses
import hashlib
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.sync.server import ServerConnection

from coordinator.ledger.database.engine import open_writer
from coordinator.ledger.opening import ledger_url_of
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.dataset.reader import Dataset
from factory.eval.models.result import Variant
from factory.eval.policies.remote import pack
from factory.eval.process.local_campaign import Pace
from factory.eval.remote.fleet import FleetAccess, run_fleet
from factory.eval.specs.campaign import Campaign
from schemas.errors import TransientError, UsageError, WorldError
from schemas.support.child import python_module
from tests.builders.evaluation import open_store, standing_still
from tests.builders.former_ledger import make_former
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.policy_server import policy_server
from tests.builders.ports import free_endpoint
from tests.builders.worker import WorkerThread, settings_for

COLLECT = python_module("tests.builders.small_simulation", "0.2")
EVALUATE = python_module("factory.eval.remote.eval_worker")


@pytest.fixture(scope="module")
def campaign(drives: Dataset) -> Campaign:
    """An evaluation of two episodes in which the robot does not move."""
    return standing_still(drives)


def archived(hub: Coordinator) -> int:
    return hub.progress().jobs["archived"]


def wait_for_more(hub: Coordinator, than: int) -> None:
    deadline = time.monotonic() + 120
    while archived(hub) <= than:
        assert time.monotonic() < deadline, "the collection makes no progress"
        time.sleep(0.1)


def test_workers_of_a_collection_run_an_evaluation_and_resume_the_collection(
    drives: Dataset, campaign: Campaign, tmp_path: Path
) -> None:
    settings = CoordinatorSettings(lease_ttl_s=15.0, reserve_bytes=0)
    plan, catalog = room_plan(2000), room_catalog(tmp_path)
    told: list[Pace] = []
    with (
        Coordinator(
            tmp_path / "collection", plan, catalog, CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings)
        ) as hub,
        WorkerThread(settings_for(hub.endpoints[0], tmp_path, command=COLLECT, eval_command=EVALUATE)),
        open_store(tmp_path / "out", campaign) as store,
    ):
        wait_for_more(hub, 0)
        door = FleetAccess(connect=hub.endpoints)
        assert run_fleet(campaign, drives.meta.plan, store, door, threading.Event(), told.append)
        assert [(row.end, row.num_steps) for row in store.results("stop")] == [("timeout", 10)] * 2
        note = store.note_of("stop")
        assert note is not None
        assert note.knows == "nothing"
        wait_for_more(hub, archived(hub))
        # all episodes have results already, so no running collection is needed
        assert run_fleet(campaign, drives.meta.plan, store, FleetAccess(), threading.Event(), told.append)
    assert [pace.done for pace in told] == [0, 1, 2, 2]
    assert not (tmp_path / "out" / "fleet").exists()


def test_waits_of_workers_for_a_policy_server_are_shown_with_their_limits(
    drives: Dataset, campaign: Campaign, tmp_path: Path
) -> None:
    first = "waiting for loading, reset or first answer, at most 70 s (--load-timeout)"
    other = "waiting for an answer, at most 60 s (--act-timeout)"
    shown = {first: threading.Event(), other: threading.Event()}
    told: list[Pace] = []

    def tell(pace: Pace) -> None:
        told.append(pace)
        if pace.waiting in shown:
            shown[pace.waiting].set()

    def answer(connection: ServerConnection, observation: dict[str, Any]) -> None:
        if observation["step"] < 2:
            shown[other if observation["step"] else first].wait(50)
        connection.send(pack({"actions": np.zeros((1, 2), np.float32)}))

    setup = campaign.setup.model_copy(update={"act_timeout_s": 60.0, "load_timeout_s": 70.0})
    with policy_server(answer) as address:
        remote = dataclasses.replace(
            campaign, policies=("act",), references={"act": address}, variants=(Variant.ORIGINAL,), setup=setup
        )
        endpoint = free_endpoint()
        with (
            WorkerThread(settings_for(endpoint, tmp_path, eval_command=EVALUATE)),
            open_store(tmp_path / "out", remote) as store,
        ):
            assert run_fleet(remote, drives.meta.plan, store, FleetAccess((endpoint,)), threading.Event(), tell)
            assert [row.end for row in store.results("act")] == ["timeout"] * 2
    assert [(pace.policy, pace.waiting) for pace in told if pace.waiting] == [("act", first), ("act", other)]


def test_an_evaluation_without_a_running_collection_reports_it(
    drives: Dataset, campaign: Campaign, tmp_path: Path
) -> None:
    door = FleetAccess(connect=(free_endpoint(),))
    with open_store(tmp_path / "out", campaign) as store, pytest.raises(TransientError, match="no coordinator at"):
        run_fleet(campaign, drives.meta.plan, store, door, threading.Event(), lambda _pace: None)


def test_an_unfinished_evaluation_of_an_older_version_is_refused_until_its_folder_is_deleted(
    drives: Dataset, campaign: Campaign, tmp_path: Path
) -> None:
    stop = threading.Event()
    stop.set()
    door = FleetAccess((free_endpoint(),))
    with open_store(tmp_path / "out", campaign) as store:
        assert not run_fleet(campaign, drives.meta.plan, store, door, stop, lambda _pace: None)
        (folder,) = (tmp_path / "out" / "fleet").iterdir()
        engine = open_writer(ledger_url_of(folder))
        with engine.begin() as connection:
            make_former(connection, 3)
        engine.dispose()
        with pytest.raises(UsageError, match=r"has format 3 of minivla-factory 0\.1\.0, .*: delete this folder"):
            run_fleet(campaign, drives.meta.plan, store, door, stop, lambda _pace: None)
        shutil.rmtree(folder)
        assert not run_fleet(campaign, drives.meta.plan, store, door, stop, lambda _pace: None)


ECHO = """
import hashlib, json, sys
def tell(**report): print(json.dumps(report), flush=True)
tell(kind="ready", renderer="none")
for line in sys.stdin:
    path = json.loads(line)["attachment_path"]
    tell(kind="failure", reason="crash", detail="given " + hashlib.sha256(open(path, "rb").read()).hexdigest())
"""
"""A program for evaluation tasks that executes none of them and reports its input."""


def test_workers_fetch_a_checkpoint_by_its_digest(drives: Dataset, campaign: Campaign, tmp_path: Path) -> None:
    weights = np.random.default_rng(1).bytes((2 << 20) + 77)
    (tmp_path / "policy.pt").write_bytes(weights)
    one = campaign.specs.only(None, 1)
    learned = dataclasses.replace(campaign, specs=one, policies=(f"bc:{tmp_path}",), variants=(Variant.ORIGINAL,))
    endpoint = free_endpoint()
    settings = settings_for(endpoint, tmp_path, eval_command=(sys.executable, "-c", ECHO))
    with (
        WorkerThread(settings),
        open_store(tmp_path / "out", learned) as store,
        pytest.raises(WorldError, match=f"given {hashlib.sha256(weights).hexdigest()}"),
    ):
        run_fleet(learned, drives.meta.plan, store, FleetAccess((endpoint,)), threading.Event(), lambda _pace: None)
    (tmp_path / "policy.pt").unlink()
    with (
        open_store(tmp_path / "none", learned) as store,
        pytest.raises(UsageError, match=r"checkpoint .* does not exist"),
    ):
        run_fleet(learned, drives.meta.plan, store, FleetAccess((endpoint,)), threading.Event(), lambda _pace: None)
