"""The spool: recovery, cleanup, and locking of folders."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
from pathlib import Path

import pytest

from schemas.errors import WorldError
from schemas.protocol.messages import Lease
from workers.client.spool import Spool, find_bundle

BUNDLE = b"0123456789" * 100


def lease(job_id: int = 1, fence: int = 1, token: str = "0") -> Lease:
    return Lease(job_id=job_id, fence=fence, token=token * 32)


def open_spool(root: Path, max_bundles: int = 4, max_bytes: int = 1 << 30) -> Spool:
    return Spool(root, max_bundles, max_bytes)


def put(spool: Spool, under: Lease, data: bytes = BUNDLE) -> None:
    spool.path_for(under).write_bytes(data)
    spool.add(under, hashlib.sha256(data).hexdigest(), len(data))


def test_bundle_is_listed_and_read_in_parts(tmp_path):
    with open_spool(tmp_path) as spool:
        put(spool, lease())
        assert [entry.lease for entry in spool.entries()] == [lease()]
        assert spool.read(1, 1, 995, 100) == BUNDLE[995:]


def test_bundle_survives_a_restart(tmp_path):
    with open_spool(tmp_path) as spool:
        put(spool, lease())
        before = spool.entries()
    with open_spool(tmp_path) as spool:
        assert spool.entries() == before
        assert spool.read(1, 1, 0, 2000) == BUNDLE


def test_finished_bundle_is_found_in_any_spool_of_the_folder_by_its_lease(tmp_path):
    with open_spool(tmp_path) as one, open_spool(tmp_path) as two:
        put(two, lease(2))
        one.path_for(lease(3)).write_bytes(BUNDLE)  # not finished
        found = find_bundle(tmp_path, lease(2))
        assert found is not None
        assert found.parent == two.directory
        assert found.read_bytes() == BUNDLE
        assert find_bundle(tmp_path, lease(3)) is None
        assert find_bundle(tmp_path, lease(2, token="1")) is None
        assert find_bundle(tmp_path / "nowhere", lease(2)) is None


def test_a_dropped_bundle_leaves_no_file(tmp_path):
    with open_spool(tmp_path) as spool:
        put(spool, lease())
        assert spool.drop(lease())
        assert not spool.drop(lease())
        assert {path.name for path in spool.directory.iterdir()} == {"lock"}


def test_bundle_under_another_token_is_not_dropped(tmp_path):
    with open_spool(tmp_path) as spool:
        put(spool, lease())
        assert not spool.drop(lease(token="1"))
        assert len(spool) == 1


def test_a_bundle_of_a_former_ledger_is_replaced_by_a_new_bundle_of_the_same_job_and_fence(tmp_path):
    with open_spool(tmp_path) as spool:
        put(spool, lease(token="0"))
        put(spool, lease(token="1"), b"new")
        assert [entry.lease.token for entry in spool.entries()] == ["1" * 32]
        assert spool.read(1, 1, 0, 10) == b"new"


def test_reading_an_unknown_bundle_raises_a_key_error(tmp_path):
    with open_spool(tmp_path) as spool, pytest.raises(KeyError):
        spool.read(9, 9, 0, 10)


@pytest.mark.parametrize(
    "mishap",
    [
        lambda folder: (folder / "2.1.zip.part").write_bytes(b"half"),
        lambda folder: (folder / "2.1.zip").write_bytes(b"whole, but never announced"),
        lambda folder: (folder / "2.1.json").write_text("{}"),
        lambda folder: (folder / "2.1.json.part").write_text("{"),
    ],
    ids=["bundle half written", "bundle without sidecar", "sidecar without bundle", "sidecar half written"],
)
def test_leftovers_of_a_crash_are_removed_at_the_start(tmp_path, mishap):
    with open_spool(tmp_path) as spool:
        put(spool, lease())
        mishap(spool.directory)
    with open_spool(tmp_path) as spool:
        assert {path.name for path in spool.directory.iterdir()} == {"lock", "1.1.zip", "1.1.json"}


def test_truncated_bundle_is_not_announced(tmp_path):
    with open_spool(tmp_path) as spool:
        put(spool, lease())
        spool.path_for(lease()).write_bytes(BUNDLE[:-1])
    with open_spool(tmp_path) as spool:
        assert not spool.entries()


def test_spool_is_full_by_count_and_by_bytes(tmp_path):
    with open_spool(tmp_path / "a", max_bundles=1) as spool:
        assert not spool.is_full
        put(spool, lease())
        assert spool.is_full
        spool.drop(lease())
        assert not spool.is_full
    with open_spool(tmp_path / "b", max_bytes=len(BUNDLE)) as spool:
        put(spool, lease())
        assert spool.is_full


def test_spool_is_full_when_the_disk_is(tmp_path):
    with Spool(tmp_path, 4, 1 << 30, min_free_bytes=1 << 62) as spool:
        assert spool.is_full


def test_second_worker_takes_another_folder(tmp_path):
    with open_spool(tmp_path) as one, open_spool(tmp_path) as other:
        put(one, lease())
        assert one.directory != other.directory
        assert not other.entries()


def test_bundles_of_a_dead_worker_are_adopted(tmp_path):
    with open_spool(tmp_path), open_spool(tmp_path) as sibling:
        put(sibling, lease(2))
        orphaned = sibling.directory
    with open_spool(tmp_path) as spool:
        assert spool.directory != orphaned
        assert [entry.lease for entry in spool.entries()] == [lease(2)]
        assert spool.read(2, 1, 0, 2000) == BUNDLE
    assert {path.name for path in orphaned.iterdir()} == {"lock"}


def test_clearing_removes_an_unfinished_attempt_but_no_bundle(tmp_path):
    with open_spool(tmp_path) as spool:
        put(spool, lease(1))
        spool.path_for(lease(2)).write_bytes(b"whole")
        Path(f"{spool.path_for(lease(2))}.part").write_bytes(b"half")
        for under in (lease(1), lease(2)):
            spool.clear(under)
        assert {path.name for path in spool.directory.iterdir()} == {"lock", "1.1.zip", "1.1.json"}


def test_files_with_a_lease_token_are_readable_only_by_their_owner(tmp_path):
    (tmp_path / "run" / "0").mkdir(parents=True, mode=0o755)
    umask = os.umask(0)
    try:
        with open_spool(tmp_path / "run") as one, open_spool(tmp_path / "run") as two:
            for spool in (one, two):
                put(spool, lease())
                assert stat.S_IMODE(spool.directory.stat().st_mode) == 0o700
                sidecars = list(spool.directory.glob("*.json"))
                assert [stat.S_IMODE(path.stat().st_mode) for path in sidecars] == [0o600]
    finally:
        os.umask(umask)


def test_every_operation_reports_a_deleted_folder_without_a_traceback(tmp_path):
    with open_spool(tmp_path / "root") as spool:
        put(spool, lease())
        shutil.rmtree(tmp_path)
        with pytest.raises(WorldError, match=r"cannot be used.*--spool"):
            _ = spool.is_full
        with pytest.raises(WorldError, match=r"cannot be used.*--spool"):
            spool.add(lease(), "0" * 64, 1)
        with pytest.raises(KeyError):
            spool.read(1, 1, 0, 10)
        spool.clear(lease())
        assert not spool.drop(lease())


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: path.write_bytes(b"short")])
def test_a_deleted_or_truncated_bundle_is_no_longer_announced(tmp_path, harm):
    with open_spool(tmp_path) as spool:
        put(spool, lease())
        harm(spool.path_for(lease()))
        with pytest.raises(KeyError):
            spool.read(1, 1, 0, 1000)
        assert spool.entries() == ()
