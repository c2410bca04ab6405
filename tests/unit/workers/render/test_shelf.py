"""Cache of prepared scenes: which scenes it keeps, and when it closes them."""

from __future__ import annotations

from schemas.scene import CompiledScene
from tests.builders.scene import Box, build_scene
from workers.render.shelf import SceneShelf


class Prepared:
    """Records its scene and whether it was closed."""

    def __init__(self, scene: CompiledScene) -> None:
        self.scene = scene
        self.is_closed = False

    def close(self) -> None:
        self.is_closed = True


def scenes(count: int) -> list[CompiledScene]:
    return [build_scene([Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))]) for _ in range(count)]


def test_a_scene_is_prepared_once_while_it_is_kept() -> None:
    shelf, (one, other) = SceneShelf(Prepared, capacity=2), scenes(2)
    first = shelf.take(one)
    shelf.take(other)
    assert shelf.take(one) is first


def test_equal_scenes_are_told_apart() -> None:
    shelf, (one, other) = SceneShelf(Prepared, capacity=2), scenes(2)
    assert shelf.take(one).scene is one
    assert shelf.take(other).scene is other


def test_the_least_recently_used_scene_is_evicted() -> None:
    shelf, (a, b, c) = SceneShelf(Prepared, capacity=2), scenes(3)
    prepared_a, prepared_b = shelf.take(a), shelf.take(b)
    shelf.take(a)
    shelf.take(c)
    assert (prepared_a.is_closed, prepared_b.is_closed) == (False, True)


def test_clearing_closes_everything() -> None:
    shelf = SceneShelf(Prepared, capacity=3)
    kept = [shelf.take(scene) for scene in scenes(3)]
    shelf.clear()
    assert all(prepared.is_closed for prepared in kept)
