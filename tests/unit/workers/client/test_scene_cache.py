"""The scene cache: fetched once, checked, evicted by use."""

from __future__ import annotations

import hashlib
import os
import threading
from pathlib import Path

import pytest

from schemas.errors import WorldError
from schemas.protocol.keys import MAX_CHUNK_BYTES, Chunk
from workers.client.scene_cache import SceneCache


class Source:
    """Serves one scene and counts the requests."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sha256 = hashlib.sha256(data).hexdigest()
        self.asked: list[Chunk] = []

    def fetch(self, chunk: Chunk) -> bytes:
        self.asked.append(chunk)
        return self.data[chunk.offset : chunk.offset + chunk.length]


def never_wait() -> None:
    raise AssertionError("waited")


def ensure(cache: SceneCache, source: Source) -> Path:
    return cache.ensure(source.sha256, len(source.data), source.fetch, never_wait)


def test_scene_is_fetched_in_chunks_once(tmp_path):
    source = Source(b"x" * (2 * MAX_CHUNK_BYTES + 5))
    cache = SceneCache(tmp_path, 1 << 30)
    assert ensure(cache, source).read_bytes() == source.data
    assert [chunk.length for chunk in source.asked] == [MAX_CHUNK_BYTES, MAX_CHUNK_BYTES, 5]
    assert ensure(cache, source) == ensure(SceneCache(tmp_path, 1 << 30), source)
    assert len(source.asked) == 3


def test_damaged_scene_is_fetched_again(tmp_path):
    source = Source(b"scene")
    path = ensure(SceneCache(tmp_path, 1 << 30), source)
    path.write_bytes(b"scemf")
    assert ensure(SceneCache(tmp_path, 1 << 30), source).read_bytes() == b"scene"


def test_a_wrong_digest_is_refused_and_the_file_is_not_kept(tmp_path):
    source = Source(b"scene")
    source.data = b"other"
    with pytest.raises(WorldError, match="arrived with SHA-256"):
        ensure(SceneCache(tmp_path, 1 << 30), source)
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".lock"]


def test_short_chunk_is_refused(tmp_path):
    source = Source(b"scene")
    with pytest.raises(WorldError, match="4 bytes at 0, expected 5"):
        SceneCache(tmp_path, 1 << 30).ensure(source.sha256, 5, lambda chunk: b"scen", never_wait)


def test_fetch_that_gives_up_leaves_no_part_file(tmp_path):
    def give_up(chunk: Chunk) -> bytes:
        raise KeyError("stopped")

    with pytest.raises(KeyError):
        SceneCache(tmp_path, 1 << 30).ensure("a" * 64, 5, give_up, never_wait)
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".lock"]


def test_two_threads_fetch_one_scene_once(tmp_path):
    source, cache, begun, goes_on = (
        Source(b"scene"),
        SceneCache(tmp_path, 1 << 30),
        threading.Event(),
        threading.Event(),
    )

    def slow(chunk: Chunk) -> bytes:
        begun.set()
        assert goes_on.wait(60)
        return source.fetch(chunk)

    first = threading.Thread(target=cache.ensure, args=(source.sha256, 5, slow, never_wait))
    first.start()
    assert begun.wait(60)
    other = SceneCache(tmp_path, 1 << 30)  # as another process would
    path = other.ensure(source.sha256, 5, source.fetch, goes_on.set)
    first.join()
    assert path.read_bytes() == b"scene"
    assert len(source.asked) == 1


def test_scene_used_longest_ago_is_evicted(tmp_path):
    old, middle, new = (Source(letter * 400) for letter in (b"a", b"b", b"c"))
    cache = SceneCache(tmp_path, 1000)
    for age, source in ((300, old), (200, middle)):
        path = ensure(cache, source)
        os.utime(path, (path.stat().st_atime - age, path.stat().st_mtime - age))
    ensure(cache, new)
    assert {path.stem for path in tmp_path.glob("*.scene")} == {middle.sha256, new.sha256}


def test_scene_larger_than_the_cache_is_kept_while_it_is_used(tmp_path):
    source = Source(b"a" * 400)
    assert ensure(SceneCache(tmp_path, 100), source).is_file()


def test_an_unwritable_folder_is_reported_with_a_remedy(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(WorldError, match="set MINIVLA_CACHE to a writable folder"):
        ensure(SceneCache(tmp_path / "file", 100), Source(b"scene"))
