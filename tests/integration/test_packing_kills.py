"""Kills the packing process at every step that changes a file or an object: no episode is lost, changed or duplicated.

In a directory, an audit hook in the process counts the file operations and kills the process before the n-th operation.
With object storage, a relay kills the process at a stage of a request.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from coordinator.archive.opening import open_archive
from schemas.storage.episode_list import list_episodes
from schemas.storage.object_path import ObjectPath
from schemas.storage.place import Place
from tests.builders.object_server import ObjectServer
from tests.builders.store_relay import Moment, StoreRelay

EPISODES = {number: hashlib.sha256(b"%d" % number).digest() * (10 + number) for number in (1, 2, 5, 9)}
DIGESTS = {number: hashlib.sha256(data).hexdigest() for number, data in EPISODES.items()}

_KILLED_AT_EACH_STEP = """
import os, shutil, signal, sys
from pathlib import Path
from coordinator.archive.opening import open_archive

digests = {digests}

def work(root):
    {work}

def count_down(left):
    def hook(event, arguments):
        nonlocal left
        if event in ("os.rename", "os.remove") or event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR):
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
    return hook

template, folder = Path(sys.argv[1]), Path(sys.argv[2])
for step in range(100):
    root = folder / str(step)
    shutil.copytree(template, root)
    child = os.fork()
    if not child:
        sys.addaudithook(count_down(step))
        work(root)
        os._exit(0)
    if os.waitpid(child, 0)[1] == 0:
        print(step)
        break
"""

_PACK = "archive.pack(digests, 1, 10); archive.write_shard_index()"


def kill_at_each_step(folder: Path, template: Path, work: str) -> int:
    """Runs `work` on copies of a directory and kills each run at a different operation; returns the number of kills."""
    command = [sys.executable, "-c", _KILLED_AT_EACH_STEP.format(digests=DIGESTS, work=work), template, folder]
    folder.mkdir()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return int(done.stdout.splitlines()[-1])  # the lines before it are log lines


def contents(root: Place) -> dict[int, bytes]:
    return {number: path.read_bytes() for number, path in list_episodes(root).episodes.items()}


def require_sound(root: Place, episodes: dict[int, bytes]) -> None:
    listed = list_episodes(root)
    assert contents(root) == episodes
    assert (listed.foreign, listed.damaged, listed.twice, listed.index_fault) == ([], {}, [], "")


def quarantined(root: Path) -> list[bytes]:
    return [path.read_bytes() for path in (root / "quarantine").glob("ep_*") if path.suffix != ".txt"]


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A directory whose episodes are files."""
    root = tmp_path / "files"
    with open_archive(root) as archive:
        for number, data in EPISODES.items():
            with archive.stage(number) as staged:
                staged.write(data)
                archive.publish(staged, number)
    return root


@pytest.fixture
def packed(files: Path, tmp_path: Path) -> Path:
    """A directory whose episodes are packed."""
    root = Path(shutil.copytree(files, tmp_path / "packed"))
    with open_archive(root) as archive:
        archive.pack(DIGESTS, 1, 10)
        archive.write_shard_index()
    return root


def test_a_packing_killed_at_any_step_loses_and_duplicates_nothing(files: Path, tmp_path: Path) -> None:
    kills = kill_at_each_step(tmp_path / "kills", files, f"archive = open_archive(root); {_PACK}")
    assert kills > len(EPISODES)
    shards = set()
    for step in range(kills):
        root = tmp_path / "kills" / str(step)
        assert contents(root) == EPISODES  # a reader finds every episode before the coordinator starts again
        with open_archive(root) as archive:
            archive.pack(DIGESTS, 1, 10)
            archive.write_shard_index()
            shards.add(tuple(archive.shards()))
        require_sound(root, EPISODES)
        assert quarantined(root) == []
    assert len(shards) == 1


@pytest.mark.slow
def test_a_restart_after_a_kill_loses_and_duplicates_nothing_if_the_restart_is_killed_too(
    files: Path, packed: Path, tmp_path: Path
) -> None:
    for number in EPISODES:
        shutil.copy(files / f"episodes/ep_{number:06d}.zip", packed / "episodes")
    (packed / "shards.parquet").unlink()
    (packed / "episodes/ep_000002.zip").write_bytes(b"other")
    kills = kill_at_each_step(tmp_path / "kills", packed, "open_archive(root)")
    assert kills > len(EPISODES)
    for step in range(kills):
        root = tmp_path / "kills" / str(step)
        assert contents(root) == EPISODES
        with open_archive(root):
            pass
        require_sound(root, EPISODES)
        assert quarantined(root) == [b"other"]


@pytest.mark.slow
def test_a_quarantine_of_a_packed_episode_killed_at_any_step_keeps_its_bytes(packed: Path, tmp_path: Path) -> None:
    work = "archive = open_archive(root); archive.quarantine(archive.path_of(5), 'torn')"
    kills = kill_at_each_step(tmp_path / "kills", packed, work)
    rest = {number: data for number, data in EPISODES.items() if number != 5}
    for step in range(kills):
        root = tmp_path / "kills" / str(step)
        assert {5: EPISODES[5]}.items() <= contents(root).items() or quarantined(root) == [EPISODES[5]]
        with open_archive(root) as archive:
            if 5 in archive.present():
                archive.quarantine(archive.path_of(5), "torn")
        require_sound(root, rest)
        assert set(quarantined(root)) == {EPISODES[5]}


def test_the_replacement_of_a_damaged_shard_killed_at_any_step_loses_no_intact_episode(
    packed: Path, tmp_path: Path
) -> None:
    (shard,) = (packed / "episodes").iterdir()
    data = shard.read_bytes()
    shard.write_bytes(data[: data.index(EPISODES[9]) + 5])
    rest = {number: content for number, content in EPISODES.items() if number != 9}
    kills = kill_at_each_step(tmp_path / "kills", packed, "open_archive(root)")
    for step in range(kills):
        root = tmp_path / "kills" / str(step)
        assert contents(root) == rest
        with open_archive(root):
            pass
        require_sound(root, rest)


_PACK_IN_BUCKET = """
import sys
from pathlib import Path
from coordinator.archive.opening import open_archive
from schemas.storage.object_path import ObjectPath
archive = open_archive(Path(sys.argv[1]), ObjectPath.at(sys.argv[2]))
digests = {digests}
{pack}
"""


@pytest.mark.parametrize("moment", [Moment.STARTED, Moment.PASSED_ON])
@pytest.mark.parametrize(("method", "key"), [("PUT", "/shard_"), ("POST", "delete"), ("PUT", "/shards.parquet")])
def test_a_packing_killed_at_a_request_to_the_store_loses_and_duplicates_nothing(
    bucket_url: Callable[[], str], object_store: ObjectServer, tmp_path: Path, moment: Moment, method: str, key: str
) -> None:
    store = ObjectPath.at(f"{bucket_url()}/run")
    for number, data in EPISODES.items():
        store.objects.put(f"episodes/ep_{number:06d}.zip", data)
    command = [sys.executable, "-c", _PACK_IN_BUCKET.format(digests=DIGESTS, pack=_PACK), tmp_path, str(store)]
    with StoreRelay(object_store.endpoint) as relay:
        victim = subprocess.Popen(command, env=os.environ | {"AWS_ENDPOINT_URL": relay.endpoint})

        def kill(at: Moment, command: str, path: str) -> bool:
            if (at, command) == (moment, method) and key in path:
                victim.kill()
                victim.wait()
            return victim.poll() is not None

        relay.watch = kill
        assert victim.wait() == -signal.SIGKILL
    assert contents(store) == EPISODES
    with open_archive(tmp_path, store) as archive:
        archive.pack(DIGESTS, 1, 10)
        archive.write_shard_index()
        assert list(archive.unpacked()) == []
    require_sound(store, EPISODES)
