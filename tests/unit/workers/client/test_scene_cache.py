"""The scene cache: fetched once, checked, evicted by use."""

from __future__ import annotations

import hashlib
import os
import threading
from pathlib import Path

import pytest

from schemas.errors import WorldError
from schemas.protocol.keys import MAX_CHUNK_BYTES, Chunk
from schemas.scene import encode_scene, read_scene
from schemas.scene.files import faulty_textures
from tests.builders.layout_package import MadeLayout, make_layout
from tests.builders.scene import box_room
from workers.client.host_lock import exclusive_lock
from workers.client.scene_cache import SceneCache


class Source:
    """Serves one scene and counts the requests."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sha256 = hashlib.sha256(data).hexdigest()
        self.asked: list[Chunk] = []

    def fetch(self, sha256: str, chunk: Chunk) -> bytes:
        assert sha256 == self.sha256
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
        SceneCache(tmp_path, 1 << 30).ensure(source.sha256, 5, lambda sha256, chunk: b"scen", never_wait)


def test_fetch_that_gives_up_leaves_no_part_file(tmp_path):
    def give_up(sha256: str, chunk: Chunk) -> bytes:
        raise KeyError("stopped")

    with pytest.raises(KeyError):
        SceneCache(tmp_path, 1 << 30).ensure("a" * 64, 5, give_up, never_wait)
    assert not [path for path in tmp_path.iterdir() if path.suffix != ".lock"]


def test_two_threads_fetch_one_scene_once(tmp_path):
    source, cache, started, goes_on = (
        Source(b"scene"),
        SceneCache(tmp_path, 1 << 30),
        threading.Event(),
        threading.Event(),
    )

    def slow(sha256: str, chunk: Chunk) -> bytes:
        started.set()
        assert goes_on.wait(60)
        return source.fetch(sha256, chunk)

    first = threading.Thread(target=cache.ensure, args=(source.sha256, 5, slow, never_wait))
    first.start()
    assert started.wait(60)
    other = SceneCache(tmp_path, 1 << 30)  # like the cache of another process
    path = other.ensure(source.sha256, 5, source.fetch, goes_on.set)
    first.join()
    assert path.read_bytes() == b"scene"
    assert len(source.asked) == 1


def test_the_least_recently_used_scene_is_evicted(tmp_path):
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


class Shelf:
    """Serves the packages and textures of layouts and counts the requests."""

    def __init__(self, *layouts: MadeLayout) -> None:
        self.files = {layout.sha256: layout.package for layout in layouts}
        for layout in layouts:
            self.files |= {texture.sha256: data for texture, data in layout.textures.items()}
        self.asked: list[str] = []

    def fetch(self, sha256: str, chunk: Chunk) -> bytes:
        self.asked.append(sha256)
        return self.files[sha256][chunk.offset : chunk.offset + chunk.length]


def ensure_layout(cache: SceneCache, shelf: Shelf, layout: MadeLayout) -> Path:
    return cache.ensure_scene(layout.sha256, len(layout.package), shelf.fetch, never_wait)


ONE, OTHER = make_layout("home_00001", shades=(40, 200)), make_layout("home_00002", shades=(90, 200))


def test_a_texture_of_two_layouts_is_fetched_once_for_a_host(tmp_path):
    shelf = Shelf(ONE, OTHER)
    for layout in (ONE, OTHER, ONE):
        path = ensure_layout(SceneCache(tmp_path, 1 << 30), shelf, layout)  # like a new process
        assert read_scene(path).info.texture_count == 2
    assert sorted(shelf.asked) == sorted(shelf.files)


def test_a_scene_that_contains_its_textures_needs_no_other_file(tmp_path):
    data = encode_scene(box_room(), level=1)
    source = Source(data)
    assert read_scene(SceneCache(tmp_path, 1 << 30).ensure_scene(source.sha256, len(data), source.fetch, never_wait))
    assert len(source.asked) == 1


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(b"x" * path.stat().st_size)])
def test_a_missing_or_damaged_texture_is_fetched_again(tmp_path, damage):
    shelf = Shelf(ONE)
    path = ensure_layout(SceneCache(tmp_path, 1 << 30), shelf, ONE)
    texture = next(iter(ONE.textures))
    damage(tmp_path / texture.file)
    shelf.asked.clear()
    assert ensure_layout(SceneCache(tmp_path, 1 << 30), shelf, ONE) == path
    assert shelf.asked == [texture.sha256]
    assert faulty_textures(path) == []


def test_a_texture_that_vanishes_while_the_worker_runs_is_fetched_again(tmp_path):
    shelf, cache = Shelf(ONE), SceneCache(tmp_path, 1 << 30)
    path = ensure_layout(cache, shelf, ONE)
    (tmp_path / next(iter(ONE.textures)).file).unlink()
    ensure_layout(cache, shelf, ONE)
    assert faulty_textures(path) == []


def test_eviction_keeps_the_textures_of_kept_packages(tmp_path):
    layouts = [make_layout(f"home_{number:05d}", shades=(40 + number, 200)) for number in range(1, 7)]
    limit = sum(len(layout.package) for layout in layouts[:3]) + 4 * max(texture.size for texture in ONE.textures)
    cache, shelf = SceneCache(tmp_path, limit), Shelf(*layouts)
    for layout in layouts:
        ensure_layout(cache, shelf, layout)
        for path in tmp_path.rglob("*.*"):  # makes every file one second older
            if path.suffix != ".lock":
                os.utime(path, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns - 10**9))
        for path in tmp_path.glob("*.scene"):
            assert faulty_textures(path) == []
    assert {path.stem for path in tmp_path.glob("*.scene")} == {layout.sha256 for layout in layouts[-3:]}
    assert {path.name for path in (tmp_path / "textures").glob("*.zst")} == {
        f"{texture.sha256}.npy.zst" for layout in layouts[-3:] for texture in layout.textures
    }


def test_a_texture_in_use_is_not_evicted(tmp_path):
    shelf = Shelf(ONE, OTHER)
    cache = SceneCache(tmp_path, 1)
    path = ensure_layout(cache, shelf, ONE)
    texture = next(texture for texture in ONE.textures if texture not in OTHER.textures)
    with exclusive_lock(tmp_path / "textures" / f"{texture.sha256}.lock", never_wait):
        ensure_layout(cache, shelf, OTHER)
    assert not path.exists()
    assert (tmp_path / texture.file).exists()


def test_texture_with_other_bytes_at_the_coordinator_is_refused(tmp_path):
    shelf = Shelf(ONE)
    texture = next(iter(ONE.textures))
    shelf.files[texture.sha256] = b"x" * texture.size
    with pytest.raises(WorldError, match="arrived with SHA-256"):
        ensure_layout(SceneCache(tmp_path, 1 << 30), shelf, ONE)
