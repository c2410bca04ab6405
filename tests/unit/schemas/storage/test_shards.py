"""The format of shards and their index: same bytes, bounded reading, damage, and outdated indexes."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from schemas.encoding.container import ContainerWriter
from schemas.errors import InvalidBundle
from schemas.storage.packed_path import PackedPath
from schemas.storage.place import digest_of, local_copy
from schemas.storage.shard_index import (
    ShardIndex,
    episode_place,
    list_shards,
    open_shard,
    packed_place,
    read_index,
    write_index,
)
from schemas.storage.shards import (
    MAX_SHARD_EPISODES,
    ShardDirectory,
    is_shard,
    range_of,
    read_shard,
    salvage_shard,
    shard_name,
    write_shard,
)

EPISODES = {number: bytes([number]) * (number * 10) for number in range(1, 9)}
NAME = shard_name(1, 1000, "0123456789abcdef")


def shard_bytes(episodes: dict[int, bytes] = EPISODES) -> bytes:
    file = io.BytesIO()
    write_shard(file, episodes.items())
    return file.getvalue()


def dataset(root: Path, episodes: dict[int, bytes] = EPISODES, name: str = NAME) -> Path:
    (root / "episodes").mkdir(parents=True, exist_ok=True)
    shard = root / "episodes" / name
    shard.write_bytes(shard_bytes(episodes))
    return shard


def contents(shard: ShardDirectory, data: bytes) -> dict[int, bytes]:
    return {
        int(number): data[offset : offset + size]
        for number, offset, size in zip(shard.numbers, shard.offsets, shard.sizes, strict=True)
    }


def test_a_shard_is_a_zip_file_whose_bytes_depend_on_its_episodes_only() -> None:
    data = shard_bytes()
    assert data == shard_bytes(dict(EPISODES))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert {info.filename: archive.read(info) for info in archive.infolist()} == {
            f"ep_{number:06d}.zip": content for number, content in EPISODES.items()
        }


def test_the_directory_gives_the_place_of_each_episode() -> None:
    data = shard_bytes()
    assert contents(read_shard(io.BytesIO(data), NAME), data) == EPISODES


@pytest.mark.parametrize(
    ("name", "is_one"),
    [
        ("shard_000001-001000-0123abcd.zip", True),
        ("shard_999001-1000000-0123abcd.zip", True),
        (shard_name(*range_of(9_999_999), "0123abcd"), True),
        ("shard_000001-001000-0123ABCD.zip", False),
        ("shard_000001-001000-0123abcd.zip.part", False),
        ("shard_1-1000-0123abcd.zip", False),
        ("../shard_000001-001000-0123abcd.zip", False),
        ("ep_000001.zip", False),
    ],
)
def test_only_a_file_with_a_canonical_name_is_a_shard(name: str, is_one: bool) -> None:
    assert is_shard(name) == is_one


@pytest.mark.parametrize(
    ("number", "expected"), [(1, (1, 1000)), (1000, (1, 1000)), (1001, (1001, 2000)), (1_000_000, (999_001, 1_000_000))]
)
def test_ranges_start_after_each_thousand(number: int, expected: tuple[int, int]) -> None:
    assert range_of(number) == expected


@pytest.mark.parametrize(
    "members",
    [
        ["ep_000002.zip", "ep_000001.zip"],
        ["ep_000001.zip", "../ep_000002.zip"],
        ["ep_000001.zip", "ep_1.zip"],
        ["ep_001001.zip"],
        ["meta.json"],
    ],
    ids=["descending", "outside", "not canonical", "outside of the range", "another file"],
)
def test_members_that_are_not_ascending_episodes_of_the_range_are_refused(members: list[str]) -> None:
    file = io.BytesIO()
    with ContainerWriter(file) as out:
        for member in members:
            out.add(member, b"content")
    with pytest.raises(InvalidBundle, match="ascending order"):
        read_shard(file, NAME)


def test_a_shard_with_too_many_episodes_is_refused_before_its_directory_is_read() -> None:
    many = shard_bytes(dict.fromkeys(range(1, MAX_SHARD_EPISODES + 2), b""))
    with pytest.raises(InvalidBundle, match="more than 1000 members"):
        read_shard(io.BytesIO(many), shard_name(1, 2000, "0" * 64))


def test_every_truncated_shard_is_refused_and_its_complete_episodes_are_salvaged() -> None:
    data = shard_bytes()
    ends = {number: data.index(content) + len(content) for number, content in EPISODES.items()}
    for length in range(0, len(data), 7):
        cut = io.BytesIO(data[:length])
        with pytest.raises(InvalidBundle):
            read_shard(cut, NAME)
        found = salvage_shard(cut, NAME)
        assert contents(found, data) == {n: EPISODES[n] for n in EPISODES if ends[n] <= length}


def test_a_flipped_byte_loses_at_most_the_episode_that_it_is_in() -> None:
    data = shard_bytes()
    for at in range(0, len(data), 3):
        damaged = bytearray(data)
        damaged[at] ^= 0xFF
        found = contents(salvage_shard(io.BytesIO(damaged), NAME), bytes(damaged))
        assert len(found) >= len(EPISODES) - 1
        assert all(content == EPISODES[number] for number, content in found.items())


def test_headers_inside_an_episode_neither_hide_nor_add_an_episode() -> None:
    nested = {1: shard_bytes({5: b"five", 6: b"six"}), 2: b"two"}
    data = shard_bytes(nested)
    assert contents(salvage_shard(io.BytesIO(data[:-1]), NAME), data) == nested


def test_a_packed_path_reads_its_episode(tmp_path: Path) -> None:
    dataset(tmp_path)
    for number, path in list_shards(tmp_path):
        assert (path.name, path.stem) == (f"ep_{number:06d}.zip", f"ep_{number:06d}")
        assert path.read_bytes() == EPISODES[number]
        with path.open("rb") as file:
            assert file.read() == EPISODES[number]
        assert path.stat().st_size == len(EPISODES[number])
        assert path.is_file()
        assert not path.is_symlink()
        assert path.parents[1] == tmp_path
        assert pickle.loads(pickle.dumps(path)) == path
        with local_copy(path) as local:
            assert local.read_bytes() == EPISODES[number]
            assert digest_of(local) == digest_of(path)


@pytest.mark.parametrize(
    "change", [{"offset": 5}, {"offset": 0}, {"size": 3}, {"name": "ep_000002.zip"}, {"offset": 1 << 40}]
)
def test_a_packed_path_at_a_wrong_place_is_not_found(tmp_path: Path, change: dict[str, object]) -> None:
    shard = dataset(tmp_path)
    right = list_shards(tmp_path).find(1)
    assert right is not None
    wrong = PackedPath(**{"shard": shard, "name": right.name, "offset": right.offset, "size": right.size} | change)  # type: ignore[arg-type]
    assert not wrong.is_file()
    with pytest.raises(FileNotFoundError, match="other content"):
        wrong.read_bytes()


def test_the_index_gives_the_same_places_as_the_directories(tmp_path: Path) -> None:
    dataset(tmp_path)
    dataset(tmp_path, {1500: b"late"}, shard_name(1001, 2000, "f" * 64))
    listed = list_shards(tmp_path)
    write_index(tmp_path / "shards.parquet", listed)
    stored = read_index(tmp_path)
    assert stored is not None
    assert list(stored) == list(listed)
    assert [number for number, _ in stored] == [*EPISODES, 1500]
    assert stored.find(9) is None


def test_an_empty_index_is_stored(tmp_path: Path) -> None:
    write_index(tmp_path / "shards.parquet", ShardIndex.of(tmp_path / "episodes", ()))
    stored = read_index(tmp_path)
    assert stored is not None
    assert len(stored) == 0
    assert stored.find(1) is None


def test_every_damaged_index_is_ignored(tmp_path: Path) -> None:
    dataset(tmp_path)
    index = list_shards(tmp_path)
    path = tmp_path / "shards.parquet"
    write_index(path, index)
    data = path.read_bytes()
    for at in range(0, len(data), 11):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
        found = read_index(tmp_path)
        assert found is None or list(found) == list(index)
        path.write_bytes(data[:at])
        assert read_index(tmp_path) is None


@pytest.mark.parametrize(
    "change",
    [
        {"names": ("../../secret.zip",)},
        {"offsets": np.array([-1])},
        {"sizes": np.array([1 << 30])},
        {"numbers": np.array([0])},
    ],
    ids=["outside", "negative offset", "huge", "no episode"],
)
def test_an_index_with_impossible_values_is_ignored(tmp_path: Path, change: dict[str, object]) -> None:
    right = {"names": (NAME,), "numbers": np.array([1]), "shards": np.array([0])}
    right |= {"offsets": np.array([43]), "sizes": np.array([10])}
    write_index(tmp_path / "shards.parquet", ShardIndex(tmp_path / "episodes", **(right | change)))  # type: ignore[arg-type]
    assert read_index(tmp_path) is None


def test_an_episode_is_found_without_an_index(tmp_path: Path) -> None:
    dataset(tmp_path)
    assert episode_place(tmp_path, 3).read_bytes() == EPISODES[3]


def test_an_outdated_index_is_replaced_by_the_directories(tmp_path: Path) -> None:
    dataset(tmp_path, {1: b"other", **{n: EPISODES[n] for n in (2, 3)}})
    write_index(tmp_path / "shards.parquet", list_shards(tmp_path))
    (tmp_path / "episodes" / NAME).unlink()
    dataset(tmp_path, name=shard_name(1, 1000, "f" * 64))
    for number, content in EPISODES.items():
        assert episode_place(tmp_path, number).read_bytes() == content
        found = packed_place(tmp_path, number)
        assert found is not None
        assert found.read_bytes() == content


def test_an_episode_file_beside_the_shards_is_found_and_a_missing_episode_has_the_path_of_its_own_file(
    tmp_path: Path,
) -> None:
    dataset(tmp_path)
    single = tmp_path / "episodes/ep_000020.zip"
    single.write_bytes(b"single")
    assert episode_place(tmp_path, 20) == single
    assert episode_place(tmp_path, 21) == tmp_path / "episodes/ep_000021.zip"


def test_a_file_that_is_packed_after_the_first_access_is_found(tmp_path: Path) -> None:
    single = tmp_path / "episodes/ep_000003.zip"
    single.parent.mkdir()
    single.write_bytes(EPISODES[3])
    assert episode_place(tmp_path, 3) == single
    dataset(tmp_path)
    single.unlink()
    assert episode_place(tmp_path, 3).read_bytes() == EPISODES[3]


def test_a_damaged_shard_gives_its_intact_episodes_and_the_damage(tmp_path: Path) -> None:
    shard = dataset(tmp_path)
    data = shard.read_bytes()
    shard.write_bytes(data[: data.index(EPISODES[8]) + 2])
    found, damage = open_shard(shard)
    assert found.numbers.tolist() == [1, 2, 3, 4, 5, 6, 7]
    assert "not a readable zip" in damage
    assert episode_place(tmp_path, 7).read_bytes() == EPISODES[7]
    assert episode_place(tmp_path, 8) == tmp_path / "episodes/ep_000008.zip"
