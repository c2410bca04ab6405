"""Cache of prepared scenes: which scenes it keeps, and when it closes them."""

from __future__ import annotations

from schemas.scene import CompiledScene
from tests.builders.scene import Box, build_scene
from workers.render.prepared_scenes import PreparedSceneCache


class Prepared:
    """Records its scene and whether it was closed."""

    def __init__(self, scene: CompiledScene) -> None:
        self.scene = scene
        self.is_closed = False

    def close(self) -> None:
        self.is_closed = True


def scenes(count: int) -> list[CompiledScene]:
    return [build_scene([Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))]) for _ in range(count)]


def take(cache: PreparedSceneCache[CompiledScene, Prepared], scene: CompiledScene) -> Prepared:
    return cache.take(id(scene), lambda: scene)


def test_a_scene_is_prepared_once_while_it_is_kept() -> None:
    cache, (one, other) = PreparedSceneCache(Prepared, capacity=2), scenes(2)
    first = take(cache, one)
    take(cache, other)
    assert take(cache, one) is first


def test_scenes_are_distinguished_by_key() -> None:
    cache, (one, other) = PreparedSceneCache(Prepared, capacity=2), scenes(2)
    assert take(cache, one).scene is one
    assert take(cache, other).scene is other
    assert cache.keys == (id(one), id(other))


def test_a_scene_is_read_only_when_it_is_prepared() -> None:
    cache, read = PreparedSceneCache(Prepared, capacity=1), []
    for key in ("a", "a", "b", "a"):
        cache.take(key, lambda key=key: read.append(key) or scenes(1)[0])
    assert read == ["a", "b", "a"]


def test_the_least_recently_used_scene_is_evicted() -> None:
    cache, (a, b, c) = PreparedSceneCache(Prepared, capacity=2), scenes(3)
    prepared_a, prepared_b = take(cache, a), take(cache, b)
    take(cache, a)
    take(cache, c)
    assert (prepared_a.is_closed, prepared_b.is_closed) == (False, True)


def test_clearing_closes_everything() -> None:
    cache = PreparedSceneCache(Prepared, capacity=3)
    kept = [take(cache, scene) for scene in scenes(3)]
    cache.clear()
    assert all(prepared.is_closed for prepared in kept)


def test_make_room_frees_the_oldest_scene_of_a_full_cache_before_the_next_scene_is_read() -> None:
    cache, (a, b) = PreparedSceneCache(Prepared, capacity=2), scenes(2)
    prepared_a, prepared_b = take(cache, a), take(cache, b)
    cache.make_room()
    assert (prepared_a.is_closed, prepared_b.is_closed, cache.keys) == (True, False, (id(b),))
    cache.make_room()
    assert not prepared_b.is_closed
