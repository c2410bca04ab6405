"""Contract suite of packing: a directory, and a bucket of a real S3 server."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

import pytest

from coordinator.archive.contract import Archive
from schemas.errors import ArchiveCorrupt
from schemas.storage.episode_list import list_episodes
from schemas.storage.packed_path import PackedPath
from schemas.storage.place import Place
from schemas.storage.shard_index import episode_place, read_index
from tests.contract.test_archives import Kind, kind, publish

__all__ = ["kind"]

EPISODES = {number: hashlib.sha256(b"%d" % number).digest() * (100 + number) for number in (1, 2, 3, 7, 10)}
FIRST, LAST = 1, 10


def digests(episodes: dict[int, bytes] = EPISODES) -> dict[int, str]:
    return {number: hashlib.sha256(data).hexdigest() for number, data in episodes.items()}


def fill(archive: Archive, numbers: Iterable[int] = EPISODES) -> None:
    for number in numbers:
        publish(archive, number, EPISODES[number])


def pack(archive: Archive) -> int:
    count = archive.pack(digests(), FIRST, LAST)
    archive.write_shard_index()
    return count


def contents(archive: Archive) -> dict[int, bytes]:
    return {number: path.read_bytes() for number, path in archive.present().items()}


def require_sound(kind: Kind, episodes: dict[int, bytes] = EPISODES) -> None:
    """Checks that both the listing and the lookup by number find exactly the expected episodes."""
    listed = list_episodes(kind.root)
    assert {number: path.read_bytes() for number, path in listed.episodes.items()} == episodes
    assert (listed.foreign, listed.damaged, listed.twice, listed.index_fault) == ([], {}, [], "")
    for number, data in episodes.items():
        assert episode_place(kind.root, number).read_bytes() == data


def quarantined(kind: Kind) -> list[Place]:
    return [path for path in (kind.root / "quarantine").iterdir() if not path.name.endswith(".txt")]


def shard_of(kind: Kind) -> Place:
    (place,) = [path for path in (kind.root / "episodes").iterdir() if path.name.startswith("shard_")]
    return place


def test_packed_episodes_keep_their_bytes_and_have_no_files(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        assert pack(archive) == len(EPISODES)
        assert contents(archive) == EPISODES
        assert list(archive.present()) == list(EPISODES)
        assert archive.unpacked() == {}
        assert archive.foreign() == []
        assert [name[:20] for name in archive.shards()] == ["shard_000001-000010-"]
        assert kind.names("episodes") == list(archive.shards())
        path = archive.path_of(7)
        assert isinstance(path, PackedPath)
        assert path.exists()
        assert not archive.path_of(4).exists()
        assert list((kind.home / ".staging").iterdir()) == []
    require_sound(kind)
    with kind.open() as archive:
        assert contents(archive) == EPISODES


def test_equal_episodes_give_equal_shards(kind: Kind, tmp_path: Path) -> None:
    with kind.open() as archive, Kind(tmp_path / "other", None).open() as other:
        fill(archive)
        fill(other, reversed(list(EPISODES)))
        assert pack(archive) == pack(other)
        assert archive.shards() == other.shards()


def test_episodes_that_differ_from_the_ledger_remain_files(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        owned = digests() | {2: "0" * 64, 9: "1" * 64}
        del owned[7]
        assert archive.pack(owned, FIRST, LAST) == 3
        assert list(archive.unpacked()) == [2, 7]
        assert contents(archive) == EPISODES


def test_packing_without_unpacked_episodes_writes_no_shard(kind: Kind) -> None:
    with kind.open() as archive:
        assert pack(archive) == 0
        assert archive.shards() == ()
        assert kind.names("episodes") == []


def test_late_episodes_get_a_second_shard(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive, (1, 3, 10))
        assert pack(archive) == 3
        fill(archive, (2, 7))
        assert contents(archive) == EPISODES
        assert pack(archive) == 2
        assert len(archive.shards()) == 2
    require_sound(kind)


def test_a_packed_episode_is_never_overwritten(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
        with pytest.raises(ArchiveCorrupt, match="already exists and is not overwritten"):
            publish(archive, 2, b"other")
        assert contents(archive) == EPISODES


def test_quarantining_a_packed_episode_keeps_its_bytes_and_the_other_episodes(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
        listed = archive.present()
        for number in (2, 7):  # the second path names a shard that the first call has replaced
            place = archive.quarantine(listed[number], "not of this plan")
            assert place.name.startswith(f"ep_{number:06d}.zip.")
            assert place.read_bytes() == EPISODES[number]
            reason = (place.parent / f"{place.name}.reason.txt").read_text(encoding="utf-8")
            assert "not of this plan" in reason
            assert listed[number].name in reason
        rest = {number: data for number, data in EPISODES.items() if number not in (2, 7)}
        assert contents(archive) == rest
        publish(archive, 2, b"again")
        assert archive.restore(place, 7).read_bytes() == EPISODES[7]
        with pytest.raises(ArchiveCorrupt, match="already exists"):
            archive.restore(quarantined(kind)[0], 1)
    require_sound(kind, rest | {2: b"again", 7: EPISODES[7]})


def test_the_last_episode_of_a_shard_can_be_quarantined(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive, (3,))
        pack(archive)
        archive.quarantine(archive.path_of(3), "torn")
        assert (archive.present(), archive.shards()) == ({}, ())
    require_sound(kind, {})


def test_unpublishing_deletes_a_packed_episode_and_may_be_repeated(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
        archive.unpublish(3)
        archive.unpublish(3)
        publish(archive, 3, b"again")
    require_sound(kind, EPISODES | {3: b"again"})


def test_files_of_an_interrupted_packing_are_deleted(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
    for number in (2, 7):
        kind.lay(f"episodes/ep_{number:06d}.zip", EPISODES[number])
    assert len(list_episodes(kind.root).twice) == 2
    with kind.open() as archive:
        assert archive.unpacked() == {}
        assert contents(archive) == EPISODES
        assert quarantined(kind) == []
    require_sound(kind)


def test_a_file_that_differs_from_the_packed_episode_is_quarantined(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
    kind.lay("episodes/ep_000002.zip", b"other")
    with kind.open() as archive:
        assert contents(archive) == EPISODES
        assert [place.read_bytes() for place in quarantined(kind)] == [b"other"]
    require_sound(kind)


def test_an_interrupted_replacement_of_a_shard_is_completed(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
        former = shard_of(kind)
        data = former.read_bytes()
        archive.unpublish(3)
    kind.lay(f"episodes/{former.name}", data)
    with kind.open() as archive:
        assert contents(archive) == EPISODES
        assert quarantined(kind) == []
    require_sound(kind)


def test_an_index_that_was_not_written_is_written_at_the_next_start(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        archive.pack(digests(), FIRST, LAST)
        assert read_index(kind.root) is None
        assert "is missing" in list_episodes(kind.root).index_fault
    with kind.open():
        pass
    require_sound(kind)


@pytest.mark.parametrize("part", [0.5, 0.9])
def test_the_intact_episodes_of_a_truncated_shard_are_kept(kind: Kind, part: float) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
    shard = shard_of(kind)
    data = shard.read_bytes()
    cut = data[: int(len(data) * part)]
    kind.lay(f"episodes/{shard.name}", cut)
    intact = {number: content for number, content in EPISODES.items() if content in cut}
    assert 2 <= len(intact) < len(EPISODES)
    assert list(list_episodes(kind.root).damaged) == [shard.name]
    assert episode_place(kind.root, 1).read_bytes() == EPISODES[1]
    with kind.open() as archive:
        assert contents(archive) == intact
        (kept,) = quarantined(kind)
        assert kept.read_bytes() == cut
        reason = (kept.parent / f"{kept.name}.reason.txt").read_text(encoding="utf-8")
        assert f"{len(intact)} intact episodes are kept in {archive.shards()[0]}" in reason
    require_sound(kind, intact)


def test_a_shard_whose_zip_directory_is_damaged_is_rewritten(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
    shard = shard_of(kind)
    data = shard.read_bytes()
    kind.lay(f"episodes/{shard.name}", data[:-30])
    with kind.open() as archive:
        assert contents(archive) == EPISODES
    assert shard_of(kind).read_bytes() == data
    require_sound(kind)


def test_a_file_with_the_name_of_a_shard_and_other_content_is_quarantined(kind: Kind) -> None:
    name = "shard_000001-001000-01234567.zip"
    kind.lay(f"episodes/{name}", b"no shard")
    with kind.open() as archive:
        assert (archive.present(), archive.shards(), archive.foreign()) == ({}, (), [])
        (kept,) = quarantined(kind)
        assert (kept.name[: len(name)], kept.read_bytes()) == (name, b"no shard")


def test_a_shard_in_another_folder_is_foreign(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
        pack(archive)
        name = archive.shards()[0]
        kind.lay(f"episodes/sub/{name}", shard_of(kind).read_bytes())
    with kind.open() as archive:
        assert contents(archive) == EPISODES
        assert archive.shards() == (name,)
        assert len(archive.foreign()) == 1
    assert [path.name for path in list_episodes(kind.root).foreign] == [path.name for path in archive.foreign()]


def test_a_full_disk_loses_nothing_and_leaves_no_part_file(kind: Kind) -> None:
    with kind.open() as archive:
        fill(archive)
    done = kind.run(f"""
import resource, signal
from schemas.errors import WorldError
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    archive.pack({digests()!r}, {FIRST}, {LAST})
except WorldError as error:
    print(error)
""")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"cannot write {kind.home}/.staging: File too large"), done.stdout
    assert list((kind.home / ".staging").iterdir()) == []
    require_sound(kind)
    with kind.open() as archive:
        assert pack(archive) == len(EPISODES)
    require_sound(kind)
