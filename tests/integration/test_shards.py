"""Shards of a run, and the dataset that joins them: real coordinators, ledgers, archives and validators."""

from __future__ import annotations

import sqlite3
import threading
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from coordinator.options import CoordinatorOptions
from coordinator.recovery.join_shards import JoinReport, JoinTarget, join_shards, require_joinable
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.dataset.site import Site, site_of
from factory.runs.ledger import progress_of
from factory.runs.shards import ShardRecorder, choose_shard, may_take_over
from schemas.dataset.meta import read_dataset_meta
from schemas.dataset.run_shard import RunShard, find_shards, parse_shard
from schemas.errors import UsageError, WorldError
from schemas.storage.place import Place
from schemas.terms import FailReason, Recording
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.shared_validator import SharedValidator
from tests.builders.wire_worker import WireWorker, bundle_for, until

EPISODES, COUNT, FAILING = 12, 3, 5
PLAN = room_plan(EPISODES, Recording.STATES)
SETTINGS = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, transport_lease_s=2.0)


def generate(site: Site, folder: Path, checker: SharedValidator, shard: RunShard | None, most: int = EPISODES) -> None:
    """Generates up to `most` episodes of a shard; the first attempt at `FAILING` fails."""
    options = CoordinatorOptions(
        listen=("tcp/127.0.0.1:0",), settings=SETTINGS, checker=checker, shard=shard, store=site.store
    )
    catalog = room_catalog(folder)
    with ExitStack() as stack:
        coordinator = stack.enter_context(Coordinator(site.state_dir, PLAN, catalog, options))
        recorder = ShardRecorder(site, shard, PLAN, catalog) if shard is not None else None
        if recorder is not None:
            recorder.record(coordinator.progress())
        worker = stack.enter_context(WireWorker(coordinator.endpoints, coordinator.run))
        done, most = coordinator.progress().jobs["archived"], min(most, coordinator.progress().planned)
        while done < most:
            job, lease = worker.job()
            if (job.index, job.attempt) == (FAILING, 1):
                assert worker.fail(lease, FailReason.COLLISION)
                continue
            assert worker.deliver(lease, bundle_for(job))
            done += 1
        until(lambda: coordinator.progress().jobs["archived"] == most)
        progress = coordinator.progress()
    if recorder is not None:
        recorder.finish(progress)


def join(out: Path, folder: Path, checker: SharedValidator, *sources: Place) -> JoinReport:
    found = [one for source in sources for one in find_shards(source)]
    require_joinable(found, PLAN, partial=False)
    target = JoinTarget(out, out, f"sqlite:///{out}/ledger.db", PLAN, room_catalog(folder))
    return join_shards(target, found, checker, datetime.now(UTC))


def shard_site(folder: Path, number: int) -> Site:
    return site_of(folder / "shards" / str(number))


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory, checker: SharedValidator) -> Path:
    """Three finished shards; the first is interrupted and resumed, the second has a failed attempt."""
    folder = tmp_path_factory.mktemp("run")
    for number in range(1, COUNT + 1):
        site, shard = shard_site(folder, number), RunShard(number=number, count=COUNT)
        site.state_dir.mkdir(parents=True)
        if number == 1:
            generate(site, folder, checker, shard, most=1)
        generate(site, folder, checker, shard)
    return folder / "shards"


def test_joined_shards_have_the_digest_and_the_failures_of_the_run_without_shards(shards, tmp_path, checker):
    whole = site_of(tmp_path / "whole")
    generate(whole, tmp_path, checker, None)
    report = join(tmp_path / "joined", tmp_path, checker, shards)
    assert (report.gathered, report.rejected, report.failed_attempts) == (EPISODES, (), 1)
    joined, expected = progress_of(site_of(tmp_path / "joined")), progress_of(whole)
    assert (joined.jobs, joined.attempts) == (expected.jobs, expected.attempts)
    assert expected.attempts == {"success": EPISODES, "collision": 1}
    assert report.digest == read_dataset_meta(whole.place).dataset_digest is not None
    assert report.digest == join(tmp_path / "joined", tmp_path, checker, shards).digest, (
        "the second join changes the dataset"
    )


def test_an_interrupted_join_is_completed_by_the_same_call(shards, tmp_path, checker):
    out = tmp_path / "joined"
    target = JoinTarget(out, out, f"sqlite:///{out}/ledger.db", PLAN, room_catalog(tmp_path))
    first = [(place, state) for place, state in find_shards(shards) if state.shard.number == 2]
    assert join_shards(target, first, checker, datetime.now(UTC)).digest is None
    report = join(out, tmp_path, checker, shards)
    assert (report.gathered, report.episodes) == (EPISODES - EPISODES // COUNT, EPISODES)
    assert report.digest is not None


def test_a_damaged_episode_of_a_shard_is_reported_and_not_copied(tmp_path, checker):
    site, shard = shard_site(tmp_path, 1), RunShard(number=1, count=1)
    site.state_dir.mkdir(parents=True)
    generate(site, tmp_path, checker, shard)
    (site.state_dir / "episodes" / "ep_000003.zip").write_bytes(b"damaged")
    report = join(tmp_path / "joined", tmp_path, checker, site.state_dir)
    assert [(one.episode, one.shard) for one in report.rejected] == [("ep_000003", str(site.state_dir))]
    assert (report.episodes, report.digest) == (EPISODES - 1, None)


def test_a_job_that_a_shard_quarantined_stays_quarantined_with_its_reason(tmp_path, checker):
    plan, site, shard = room_plan(2, Recording.STATES, crashes=2), site_of(tmp_path / "1"), RunShard(number=1, count=1)
    catalog = room_catalog(tmp_path)
    options = CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=SETTINGS, checker=checker, shard=shard)
    with Coordinator(site.state_dir, plan, catalog, options) as coordinator:
        for host in ("one", "two"):
            with WireWorker(coordinator.endpoints, coordinator.run, host) as worker:
                while (given := worker.job())[0].index != 1:
                    assert worker.deliver(given[1], bundle_for(given[0]))
                assert worker.fail(given[1], FailReason.CRASH)
                until(lambda: coordinator.progress().jobs["submitted"] == 0)
        assert coordinator.wait(60)
        ShardRecorder(site, shard, plan, catalog).finish(coordinator.progress())
    out = tmp_path / "joined"
    target = JoinTarget(out, out, f"sqlite:///{out}/ledger.db", plan, catalog)
    found = list(find_shards(site.place))
    report = join_shards(target, found, checker, datetime.now(UTC))
    joined = progress_of(site_of(out))
    assert joined.finished
    assert (joined.jobs["failed"], joined.jobs["archived"], joined.jobs["pending"]) == (1, 1, 0)
    assert report.digest == read_dataset_meta(site.place).dataset_digest
    with sqlite3.connect(out / "ledger.db") as ledger:
        ((reason,),) = ledger.execute("SELECT reason FROM jobs WHERE state = 'failed'").fetchall()
    assert "quarantined in shard 1/1 after 2 worker failures; the last was crash: as asked" in reason
    assert join_shards(target, found, checker, datetime.now(UTC)) == report.model_copy(update={"gathered": 0})


@pytest.mark.parametrize(
    ("numbers", "change", "message"),
    [
        ((1, 3), {}, r"1 of 3 shards are missing: 2/3"),
        ((1, 2, 3, 3), {}, r"are both shard 3/3: give one of them"),
        ((1, 2, 3), {"finished": False}, r"1 of 3 shards are not finished: 2/3"),
        ((1, 2, 3), {"shard": RunShard(number=2, count=4)}, r"all shards of a run have the same N in --shard K/N"),
        ((1, 2, 3), {"plan_digest": "0" * 64, "run": "other-1"}, r"is a shard of run other-1, not of the requested"),
        ((1, 2, 3), {"scenes": {"room": "1" * 64}}, r"used different packages of scene room"),
        ((1, 2, 3), {"versions": ("0.0.9",)}, r"was generated by minivla-factory 0\.0\.9"),
        ((), {}, r"no shard was found"),
    ],
)
def test_shards_that_do_not_form_one_run_are_refused_with_the_reason(shards, numbers, change, message):
    states = {state.shard.number: (place, state) for place, state in find_shards(shards)}
    states[2] = (states[2][0], states[2][1].model_copy(update=change))
    given = [(states[number][0].with_name(f"{number}.{k}"), states[number][1]) for k, number in enumerate(numbers)]
    with pytest.raises(UsageError, match=message):
        require_joinable(given, PLAN, partial=False)


def test_missing_and_unfinished_shards_can_be_joined_on_request(shards):
    given = [(place, state.model_copy(update={"finished": False})) for place, state in find_shards(shards)]
    require_joinable(given[:2], PLAN, partial=True)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ("1/4", "contains shard 1/3 of the run, but shard 1/4 of it was requested"),
        ("2/3", "but shard 2/3 of it was requested"),
    ],
)
def test_another_shard_or_count_in_the_directory_of_a_shard_is_refused(shards, asked, message):
    site = site_of(shards / "1")
    with pytest.raises(UsageError, match=message):
        choose_shard(site, parse_shard(asked), PLAN, is_new=False)
    assert choose_shard(site, None, PLAN, is_new=False) == RunShard(number=1, count=COUNT)


def test_a_shard_is_recognised_by_its_ledger_if_its_state_file_is_lost(tmp_path, checker):
    site, shard = shard_site(tmp_path, 1), RunShard(number=1, count=4)
    site.state_dir.mkdir(parents=True)
    generate(site, tmp_path, checker, shard)
    (site.state_dir / "run_shard.json").unlink()
    assert choose_shard(site, None, PLAN, is_new=False) == shard
    with pytest.raises(UsageError, match="contains shard 1/4 of the run, but the whole run was requested"):
        generate(site, tmp_path, checker, None)


def test_a_directory_with_the_whole_run_is_refused_as_a_shard(tmp_path, checker):
    whole = site_of(tmp_path / "whole")
    generate(whole, tmp_path, checker, None)
    with pytest.raises(UsageError, match="contains the whole run, but shard 1/3 of it was requested"):
        choose_shard(whole, parse_shard("1/3"), PLAN, is_new=False)


def test_more_shards_than_episodes_are_refused(tmp_path):
    with pytest.raises(UsageError, match="has 12 episodes; use at most 12 shards"):
        choose_shard(site_of(tmp_path / "new"), parse_shard("1/13"), PLAN, is_new=True)


def test_a_shard_in_a_bucket_is_taken_over_only_if_its_state_does_not_change(
    tmp_path, bucket_url, checker, monkeypatch
):
    url, shard = f"{bucket_url()}/1", RunShard(number=1, count=COUNT)
    monkeypatch.setenv("MINIVLA_STATE", str(tmp_path / "node-1"))
    first = site_of(url)
    options = CoordinatorOptions(
        listen=("tcp/127.0.0.1:0",), settings=SETTINGS, checker=checker, shard=shard, store=first.store
    )
    killed = Coordinator(first.state_dir, PLAN, room_catalog(tmp_path), options)
    recorder = ShardRecorder(first, shard, PLAN, room_catalog(tmp_path))
    progress = killed.progress()
    recorder.record(progress)
    monkeypatch.setenv("MINIVLA_STATE", str(tmp_path / "node-2"))
    second, stop = site_of(url), threading.Event()
    assert may_take_over(second, stop, patience_s=0.2, pause_s=0.1)
    heartbeat_due = threading.Timer(0.05, recorder.finish, [progress])
    heartbeat_due.start()
    with pytest.raises(WorldError, match="another process runs the shard"):
        may_take_over(second, stop, patience_s=60.0, pause_s=0.1)
    heartbeat_due.join()
    with (
        Coordinator(second.state_dir, PLAN, room_catalog(tmp_path), replace(options, take_over=True)),
        pytest.raises(WorldError, match="has taken over the shard"),
    ):
        ShardRecorder(first, shard, PLAN, room_catalog(tmp_path)).record(progress)
    killed.close()
    assert not may_take_over(second, stop), "a closed coordinator holds the lock"
