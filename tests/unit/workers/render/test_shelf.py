"""Cache of prepared scenes: which scenes it keeps, and when it closes them."""

from __future__ import annotations

from schemas.scene import CompiledScene
from tests.builders.scene import Box, build_scene
from workers.render.shelf import PreparedSceneCache


class Prepared:
    """Records its scene and whether it was closed."""

    def __init__(self, scene: CompiledScene) -> None:
        self.scene = scene
        self.is_closed = False

    def close(self) -> None:
        self.is_closed = True


def scenes(count: int) -> list[CompiledScene]:
    return [build_scene([Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))]) for _ in range(count)]


def take(shelf: PreparedSceneCache[CompiledScene, Prepared], scene: CompiledScene) -> Prepared:
    return shelf.take(id(scene), lambda: scene)


def test_a_scene_is_prepared_once_while_it_is_kept() -> None:
    shelf, (one, other) = PreparedSceneCache(Prepared, capacity=2), scenes(2)
    first = take(shelf, one)
    take(shelf, other)
    assert take(shelf, one) is first


def test_scenes_are_distinguished_by_key() -> None:
    shelf, (one, other) = PreparedSceneCache(Prepared, capacity=2), scenes(2)
    assert take(shelf, one).scene is one
    assert take(shelf, other).scene is other
    assert shelf.keys == (id(one), id(other))


def test_a_scene_is_read_only_when_it_is_prepared() -> None:
    shelf, read = PreparedSceneCache(Prepared, capacity=1), []
    for key in ("a", "a", "b", "a"):
        shelf.take(key, lambda key=key: read.append(key) or scenes(1)[0])
    assert read == ["a", "b", "a"]


def test_the_least_recently_used_scene_is_evicted() -> None:
    shelf, (a, b, c) = PreparedSceneCache(Prepared, capacity=2), scenes(3)
    prepared_a, prepared_b = take(shelf, a), take(shelf, b)
    take(shelf, a)
    take(shelf, c)
    assert (prepared_a.is_closed, prepared_b.is_closed) == (False, True)


def test_clearing_closes_everything() -> None:
    shelf = PreparedSceneCache(Prepared, capacity=3)
    kept = [take(shelf, scene) for scene in scenes(3)]
    shelf.clear()
    assert all(prepared.is_closed for prepared in kept)
