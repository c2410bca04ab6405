"""An archive in a bucket of an S3 server on loopback: failures between a coordinator and its store."""

from __future__ import annotations

import multiprocessing
import shutil
import traceback
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest

from coordinator.archive.contract import Archive
from coordinator.archive.objects import ObjectArchive
from coordinator.archive.opening import open_archive
from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.options import CoordinatorOptions
from coordinator.recovery.repair_dataset import RepairInput, repair
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from coordinator.tables.card import names_split_tables
from coordinator.tables.split_tables import find_faults, read_pictures, split_tables_of
from coordinator.validation.validator import Validator
from factory.dataset.reader import Dataset
from factory.stats import measure_dataset
from factory.verify.dataset import verify
from schemas.errors import ArchiveCorrupt, UsageError, WorldError
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import place_of, table_of
from tests.builders.archived import ArchivedRun
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.object_server import SECRET, ObjectServer
from tests.builders.store_relay import StoreRelay
from tests.builders.wire_worker import WireWorker, bundle_for, until

ANY_PORT = ("tcp/127.0.0.1:0",)
BIG = bytes(range(256)) * 4096


def publish(archive: Archive, index: int, data: bytes) -> None:
    with archive.stage(index) as staged:
        staged.write(data)
        archive.publish(staged, index)


def message_of(action: Callable[[], object]) -> str:
    """Runs an action that must fail; returns the error message and asserts that the error contains no secret."""
    with pytest.raises(WorldError) as caught:
        action()
    everything = "".join(traceback.format_exception(caught.value))
    assert SECRET not in everything
    assert "StringToSign" not in everything
    assert "Signature" not in everything
    return str(caught.value)


def copy_to(store: ObjectPath, folder: Path) -> None:
    for path in folder.rglob("*"):
        if path.is_file() and not path.name.startswith((".", "ledger.")):
            store.objects.put(str(path.relative_to(folder)), path.read_bytes())


def test_arrow_reads_a_table_in_a_bucket_without_a_python_file_object(store: ObjectPath) -> None:
    store.objects.put("table", BIG)
    with table_of(store / "table") as source:  # with a Python file object, some processes abort at their exit
        assert isinstance(source, pa.NativeFile)
        assert not isinstance(source, pa.PythonFile)
        assert source.read() == BIG
    with pytest.raises(FileNotFoundError):
        table_of(store / "missing")


def test_missing_bucket_is_named_with_the_remedy(store: ObjectPath, tmp_path: Path) -> None:
    said = message_of(lambda: open_archive(tmp_path, ObjectPath.at("s3://never-made/run")))
    assert said.startswith("cannot write s3://never-made/run/.lock: the store answers 404 Not Found (NoSuchBucket)")
    assert "create the bucket" in said


def test_refused_access_is_named_without_the_text_of_the_server(
    store: ObjectPath, relay: StoreRelay, tmp_path: Path
) -> None:
    relay.is_denying = True
    said = message_of(lambda: open_archive(tmp_path, store))
    assert said.startswith(f"cannot write {store}/.lock: the store answers 403 Forbidden")
    assert "check the credentials" in said


def test_absent_credentials_are_named(store: ObjectPath, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", "http://127.0.0.1:9")
    said = message_of(lambda: open_archive(tmp_path, ObjectPath.at(f"{store}/no-credentials")))
    assert "no credentials were found; set AWS_ACCESS_KEY_ID" in said


def test_credentials_in_a_url_are_refused_and_not_repeated() -> None:
    with pytest.raises(UsageError, match="a URL must not contain credentials") as caught:
        place_of(f"s3://tester:{SECRET}@bucket/run")
    assert SECRET not in str(caught.value)


@pytest.mark.parametrize("url", ["s3://", "ftp://host/run", "s3://bucket/../other", "s3://bucket/run?versionId=1"])
def test_an_incomplete_url_is_refused(url: str) -> None:
    with pytest.raises(UsageError, match="is not a valid location of a dataset"):
        place_of(url)


def test_file_url_is_a_directory() -> None:
    assert place_of("file:///data/my%20run") == Path("/data/my run")


def test_an_unreachable_server_is_named(store: ObjectPath, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    said = message_of(lambda: open_archive(tmp_path, ObjectPath.at(f"{store}/away")))
    assert "the store cannot be reached; check the network and AWS_ENDPOINT_URL" in said


def test_an_interrupted_upload_leaves_nothing_and_may_be_repeated(
    store: ObjectPath, relay: StoreRelay, tmp_path: Path
) -> None:
    with open_archive(tmp_path, store) as archive:
        relay.is_cutting = True
        said = message_of(lambda: publish(archive, 1, BIG))
        assert "cannot write" in said
        assert "ep_000001.zip: the store cannot be reached" in said
        assert archive.present() == {}
        assert list((tmp_path / ".staging").iterdir()) == []
        relay.is_cutting = False
        publish(archive, 1, BIG)
        assert archive.present()[1].read_bytes() == BIG


def test_an_upload_whose_answer_was_lost_counts_as_published(
    store: ObjectPath, relay: StoreRelay, tmp_path: Path
) -> None:
    with open_archive(tmp_path, store) as archive:
        relay.answers_to_lose = 1
        publish(archive, 1, BIG)
        assert relay.answers_to_lose == 0
        assert archive.present()[1].read_bytes() == BIG
        with pytest.raises(ArchiveCorrupt, match="is not overwritten"):
            publish(archive, 1, BIG[::-1])


def test_an_unfinished_multipart_upload_is_not_listed(
    store: ObjectPath, object_store: ObjectServer, tmp_path: Path
) -> None:
    bucket, prefix = str(store).removeprefix("s3://").split("/")
    key = f"{prefix}/episodes/ep_000001.zip"
    started = object_store.client.create_multipart_upload(Bucket=bucket, Key=key)
    object_store.client.upload_part(Bucket=bucket, Key=key, UploadId=started["UploadId"], PartNumber=1, Body=BIG)
    with open_archive(tmp_path, store) as archive:
        assert archive.present() == {}
        assert archive.foreign() == []
        publish(archive, 1, b"whole")
        assert archive.present()[1].read_bytes() == b"whole"


def test_store_that_ignores_conditions_is_refused(store: ObjectPath, relay: StoreRelay, tmp_path: Path) -> None:
    relay.ignores_conditions = True
    assert "ignores conditional writes" in message_of(lambda: open_archive(tmp_path, store))
    assert list(store.walk()) == []


def test_a_dataset_belongs_to_one_coordinator_until_it_is_closed_or_taken_over(
    store: ObjectPath, tmp_path: Path
) -> None:
    first = ObjectArchive(store, tmp_path / "first")
    said = message_of(lambda: open_archive(tmp_path / "second", store))
    assert f"{store} is in use by another coordinator, that of {tmp_path / 'first'} on host" in said
    assert f"factory repair --take-over {store}" in said
    with open_archive(tmp_path / "second", store, take_over=True):
        first.close()
        assert "is in use by another coordinator" in message_of(lambda: open_archive(tmp_path / "first", store))
    with open_archive(tmp_path / "first", store):
        pass
    assert list(store.walk()) == []


def test_a_forked_process_raises_an_error_instead_of_hanging(store: ObjectPath) -> None:
    store.objects.put("note", b"text")
    said: multiprocessing.Queue[str] = multiprocessing.get_context("fork").Queue()
    child = multiprocessing.get_context("fork").Process(target=_read_in_child, args=(store, said))
    child.start()
    assert "multiprocessing_context='spawn'" in said.get(timeout=60)
    child.join(60)


def _read_in_child(store: ObjectPath, said: multiprocessing.Queue[str]) -> None:
    try:
        (store / "note").read_bytes()
    except UsageError as error:
        said.put(str(error))


def test_an_object_is_read_like_a_file(store: ObjectPath) -> None:
    data = bytes(range(251)) * 12_000  # longer than the parts that are read in advance at the start and at the end
    store.objects.put("big", data)
    with (store / "big").open() as file:
        assert file.seek(0, 2) == len(data)
        for start, count in ((len(data) - 22, 22), (0, 100), (1_000_000, 2_000_000), (5, 0), (len(data) - 3, 10)):
            file.seek(start)
            assert file.read(count) == data[start : start + count]
        file.seek(0)
        assert file.read() == data
    with pytest.raises(FileNotFoundError):
        (store / "nothing").open()


def test_a_run_resumes_after_an_outage_of_its_store(store: ObjectPath, relay: StoreRelay, tmp_path: Path) -> None:
    settings = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0, lease_ttl_s=60.0)
    plan, catalog = room_plan(2), room_catalog(tmp_path)
    with (
        Coordinator(
            tmp_path / "home", plan, catalog, CoordinatorOptions(listen=ANY_PORT, settings=settings, store=store)
        ) as running,
        WireWorker(running.endpoints, running.run) as worker,
    ):
        job, lease = worker.job()
        relay.is_cutting = True
        worker.deliver(lease, bundle_for(job))
        until(lambda: relay.cuts > 0)
        assert running.progress().jobs.get("archived", 0) == 0
        relay.is_cutting = False
        until(lambda: bool(worker.beat().drop))  # each heartbeat announces the bundle again
        job, lease = worker.job()
        worker.deliver(lease, bundle_for(job))
        until(running.is_finished)
    found = Dataset(str(store))
    assert (len(found), found.meta.complete) == (2, True)
    assert list(find_faults(store, deep=True)) == []
    pictures = [read_pictures(store / table.name) for table in split_tables_of(store)]
    assert sum(map(len, pictures)) == 2
    assert names_split_tables((store / "README.md").read_text())
    # only the scene has findings, because its package contains no arrays
    assert {finding.file.split("/")[0] for finding in verify(store, deep=True).findings} == {"scenes"}
    assert not (store / ".lock").exists()
    assert (tmp_path / "home/ledger.db").is_file()


def delete_state_directory(ledger: Path) -> None:
    shutil.rmtree(ledger.parent)


def delete_ledger(ledger: Path) -> None:
    ledger.unlink()


def flip_bits_of_ledger(ledger: Path) -> None:
    data = bytearray(ledger.read_bytes())
    data[len(data) // 3 : len(data) // 2] = bytes(byte ^ 0x55 for byte in data[len(data) // 3 : len(data) // 2])
    ledger.write_bytes(data)


def truncate_ledger(ledger: Path) -> None:
    ledger.write_bytes(ledger.read_bytes()[: ledger.stat().st_size // 2])


@pytest.mark.parametrize("accident", [delete_state_directory, delete_ledger, flip_bits_of_ledger, truncate_ledger])
def test_a_start_after_losing_the_ledger_keeps_every_whole_episode_of_a_bucket(
    accident: Callable[[Path], None], store: ObjectPath, tmp_path: Path
) -> None:
    run = ArchivedRun(tmp_path / "out", planned=4, done=3, misses=3)
    copy_to(store, run.root)
    home = tmp_path / "home"
    home.mkdir()
    shutil.copy(run.root / "ledger.db", home / "ledger.db")
    accident(home / "ledger.db")
    before = {path.name: path.read_bytes() for path in (store / "episodes").iterdir()}
    failed = Dataset(store).meta.failed_attempts
    settings = CoordinatorSettings(reserve_bytes=0)
    with Coordinator(
        home, run.plan, run.catalog, CoordinatorOptions(listen=ANY_PORT, settings=settings, store=store)
    ) as running:
        counts = running.progress().jobs
        assert (counts["archived"], counts["pending"]) == (3, 1)
    assert {path.name: path.read_bytes() for path in (store / "episodes").iterdir()} == before
    assert list((store / "quarantine").walk()) == []
    assert ledger_trouble(ledger_url_of(home), run.catalog) == ""
    assert (len(Dataset(store)), Dataset(store).meta.failed_attempts) == (3, failed)


def test_another_plan_on_a_bucket_without_ledger_is_refused_and_moves_nothing(
    store: ObjectPath, tmp_path: Path
) -> None:
    run = ArchivedRun(tmp_path / "out")
    copy_to(store, run.root)
    with pytest.raises(UsageError, match="none belongs to run room"):
        Coordinator(tmp_path / "home", room_plan(7), run.catalog, CoordinatorOptions(listen=ANY_PORT, store=store))
    assert sorted(path.name for path in (store / "episodes").walk()) == [f"ep_{i:06d}.zip" for i in (1, 2, 3)]
    assert list((store / "quarantine").walk()) == []


def test_reader_verification_and_statistics_agree_for_a_bucket(store: ObjectPath, tmp_path: Path) -> None:
    run = ArchivedRun(tmp_path / "out")
    copy_to(store, run.root)
    here, there = Dataset(run.root), Dataset(str(store))
    assert here.digest == there.digest
    for one, other in zip(here, there, strict=True):
        assert one.meta == other.meta
        assert all((a == b).all() for a, b in zip(one.frame(-1), other.frame(-1), strict=True))
    alike = {"dataset": ""}
    assert measure_dataset(run.root).model_copy(update=alike) == measure_dataset(store).model_copy(update=alike)
    assert verify(store).findings == verify(run.root).findings
    damaged = bytearray((store / "episodes/ep_000002.zip").read_bytes())
    damaged[len(damaged) // 2] ^= 1
    store.objects.put("episodes/ep_000002.zip", bytes(damaged))
    store.objects.delete("episodes/ep_000003.zip")
    store.objects.put("episodes/sub/ep_000001.zip", b"astray")
    kinds = sorted((str(finding.kind), finding.file) for finding in verify(store).findings)
    assert ("changed", "episodes/ep_000002.zip") in kinds
    assert ("missing", "episodes/ep_000003.zip") in kinds
    assert ("foreign", "episodes/sub/ep_000001.zip") in kinds
    assert "ep_000003" in measure_dataset(store).remarks[0].text


def test_repair_rebuilds_a_lost_ledger_from_the_bucket_and_quarantines_damaged_files(
    store: ObjectPath, tmp_path: Path
) -> None:
    run = ArchivedRun(tmp_path / "out")
    copy_to(store, run.root)
    store.objects.put("episodes/ep_000002.zip", b"torn")
    store.objects.put("episodes/sub/notes.txt", b"mine")
    home = tmp_path / "home"
    repair_input = RepairInput(store, home, f"sqlite:///{home}/ledger.db", run.plan, run.catalog, {})
    with Validator() as validator:
        report = repair(repair_input, validator, run.timed_ledger.now, apply=True)
        again = repair(repair_input, validator, run.timed_ledger.now, apply=False)
    assert sorted(str(action.kind) for action in report.actions) == [
        "adopt",
        "adopt",
        "quarantine",
        "quarantine",
        "rebuild",
    ]
    assert (report.episodes, report.planned) == (2, 3)
    assert again.is_sound
    assert sorted(path.name for path in (store / "episodes").walk()) == ["ep_000001.zip", "ep_000003.zip"]
    assert any(path.read_bytes() == b"torn" for path in (store / "quarantine").iterdir())
    assert len(Dataset(str(store))) == 2


def test_a_wrong_clock_is_named_as_the_cause_of_a_refusal(store: ObjectPath, relay: StoreRelay, tmp_path: Path) -> None:
    relay.is_denying, relay.denial = True, "RequestTimeTooSkewed"
    assert "set the clock of this host" in message_of(lambda: open_archive(tmp_path, store))


def test_an_unreachable_store_is_not_reported_as_damage(store: ObjectPath, relay: StoreRelay, tmp_path: Path) -> None:
    run = ArchivedRun(tmp_path / "out")
    copy_to(store, run.root)
    found = Dataset(str(store))
    relay.is_denying = True
    assert "403" in message_of(lambda: verify(store))
    assert "403" in message_of(lambda: found[0].rgb(0))
    repair_input = RepairInput(store, run.root, run.url, run.plan, run.catalog, {})
    with Validator() as validator:
        assert "403" in message_of(lambda: repair(repair_input, validator, run.timed_ledger.now, apply=False))


@pytest.mark.parametrize("kind", ["directory", "bucket"])
def test_tables_left_unwritten_by_a_killed_coordinator_are_written_by_the_next_one(
    kind: str, store: ObjectPath, tmp_path: Path
) -> None:
    run = ArchivedRun(tmp_path / "out", planned=2, done=2)
    tables = ("metadata.parquet", "attempts.parquet", "dataset_meta.json")
    if kind == "bucket":
        copy_to(store, run.root)
    place = store if kind == "bucket" else run.root
    older = ArchivedRun(tmp_path / "older", planned=2, done=1)
    for name in tables:
        if isinstance(place, ObjectPath):
            place.objects.put(name, (older.root / name).read_bytes())
        else:
            (place / name).write_bytes((older.root / name).read_bytes())
    assert len(Dataset(place)) == 1
    settings = CoordinatorSettings(reserve_bytes=0)
    remote = store if kind == "bucket" else None
    with Coordinator(
        run.root, run.plan, run.catalog, CoordinatorOptions(listen=ANY_PORT, settings=settings, store=remote)
    ) as running:
        assert running.is_finished()
    assert (len(Dataset(place)), Dataset(place).meta.complete) == (2, True)
