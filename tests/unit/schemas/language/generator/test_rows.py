"""Counting the objects along one side of the way ahead, such as racks of an aisle, and what is in view at the start."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from schemas.language.expression import Family, ViewSide
from schemas.language.generator.minimal import minimal_expressions
from schemas.language.generator.search import Search
from schemas.language.generator.view_facts import ViewFacts
from schemas.language.graph.scene_graph import build_graph
from schemas.language.graph.view import SceneView, look
from schemas.language.route.meaning import DrivenPath, StepKind
from schemas.language.route.steps import RouteSearch, SceneRoutes
from schemas.language.scene import SceneLanguage
from schemas.language.sentence.grammar import LANGUAGES, grammar
from schemas.language.sentence.reading import reader
from tests.builders.language import CAMERA, driven, number_at, two_rooms
from tests.builders.scene import Box, build_scene, room_walls

HEAD, SIDE = (-8.0, 0.0, 0.0), 1.5
"""Start at the head of the aisle, heading east, and the middle of the rows on both sides."""


def _rack(x: float, y: float, length: float = 2.0) -> Box:
    return Box((x - length / 2, y - 0.4, 0.0), (x + length / 2, y + 0.4, 2.5), category="rack")


_LEFT = tuple(_rack(x, SIDE) for x in (-5.0, -2.0, 1.0))
_BEHIND = tuple(_rack(x, SIDE + 0.9) for x in (-5.0, -2.0))
"""A second row, back to back with the first."""
_RIGHT = (_rack(-4.0, -SIDE), _rack(0.0, -SIDE), _rack(0.6, -SIDE - 0.9))


@functools.cache
def aisle() -> SceneLanguage:
    """Returns a hall with an aisle between two rows of racks."""
    boxes = (*room_walls((-9.0, -5.0), (9.0, 5.0)), *_LEFT, *_BEHIND, *_RIGHT)
    return SceneLanguage(build_graph(build_scene(boxes, name="aisle")))


def rack_at(x: float, y: float) -> int:
    centres = aisle().facts.centre
    return int(np.argmin(np.hypot(centres[:, 0] - x, centres[:, 1] - y)))


def fitting(phrase: str, start: tuple[float, float, float] = HEAD) -> set[int]:
    """Returns the racks that a phrase certainly fits; empty if another rack is a borderline case."""
    (expression,) = reader("en").read_phrase(phrase)
    found = aisle().verifier.evaluate(expression, look(aisle().graph, start, CAMERA))
    return set(found.sure) if found.sure == found.possible else set()


@pytest.mark.parametrize(
    ("phrase", "place"),
    [
        ("the first rack ahead on your left", (-5.0, SIDE)),
        ("the second rack ahead on your left", (-2.0, SIDE)),
        ("the third rack ahead on your left", (1.0, SIDE)),
        ("the first rack ahead on your right", (-4.0, -SIDE)),
        ("the second rack ahead on your right", (0.0, -SIDE)),
        ("the third rack ahead on your right", None),  # the third rack is hidden behind the second one
        ("the fourth rack ahead on your left", None),
    ],
)
def test_racks_are_counted_along_the_aisle_and_not_in_the_row_behind(phrase, place):
    assert fitting(phrase) == (set() if place is None else {rack_at(*place)})


def test_a_rack_beside_the_robot_is_neither_ahead_nor_behind():
    assert fitting("the first rack ahead on your left", (-5.0, 0.0, 0.0)) == set()
    assert fitting("the first rack ahead on your left", (-3.9, 0.0, 0.0)) == {rack_at(-2.0, SIDE)}
    assert fitting("the first rack ahead on your right", (-3.0, 0.0, np.pi)) == {rack_at(-5.0, SIDE)}


@functools.cache
def _barrels() -> SceneLanguage:
    """Returns a hall with two barrels side by side, a third behind them, and a fourth behind a wall on the right."""
    spots = ((-4.0, 1.0), (-4.0, 2.2), (-2.5, 1.0), (-4.0, -1.5))
    barrels = [Box((x - 0.3, y - 0.3, 0.0), (x + 0.3, y + 0.3, 0.9), category="barrel") for x, y in spots]
    wall = Box((-6.0, -4.0, 0.0), (-5.9, -0.3, 2.5))
    boxes = (*room_walls((-9.0, -5.0), (9.0, 5.0)), wall, *barrels)
    return SceneLanguage(build_graph(build_scene(boxes, name="barrels")))


@pytest.mark.parametrize("phrase", ["the second barrel ahead on your left", "the first barrel ahead on your right"])
def test_a_visible_neighbour_is_counted_and_an_object_behind_a_wall_is_not(phrase):
    scene = _barrels()
    (expression,) = reader("en").read_phrase(phrase)
    view = look(scene.graph, HEAD, CAMERA)
    found = scene.verifier.evaluate(expression, view)
    assert set(found.sure) != set(found.possible) or not found.sure
    facts = ViewFacts(scene.facts, view)
    side = ViewSide.AHEAD_LEFT if "left" in phrase else ViewSide.AHEAD_RIGHT
    place = 2 if "second" in phrase else 1
    all_barrels = scene.facts.described("barrel", None)
    for number in np.flatnonzero(all_barrels.sure).tolist():
        row = facts.row(all_barrels, side, number)
        assert row[place - 1 : place] != [number]


def test_generator_and_verifier_count_the_same_racks():
    rng, count = np.random.default_rng(0), 0
    for x in np.arange(-8.0, 4.0, 0.4).tolist():
        start = (x, float(rng.uniform(-0.4, 0.4)), float(rng.uniform(-0.2, 0.2)))
        view = look(aisle().graph, start, CAMERA)
        facts = ViewFacts(aisle().facts, view)
        for side in (ViewSide.AHEAD_LEFT, ViewSide.AHEAD_RIGHT):
            racks = aisle().facts.described("rack", None)
            rows = [facts.row(racks, side, number)[:4] for number in np.flatnonzero(racks.sure).tolist()]
            row = max(rows, key=len)
            for place, number in enumerate(row):
                word = ("first", "second", "third", "fourth")[place]
                phrase = f"the {word} rack ahead on your {side.removeprefix('ahead_')}"
                assert fitting(phrase, start) == {number}, (phrase, start)
                count += 1
    assert count > 30


@pytest.mark.parametrize("code", LANGUAGES)
def test_a_rack_of_a_row_is_named_by_its_place_in_every_language(code):
    view, source = look(aisle().graph, HEAD, CAMERA), grammar(code)
    target = rack_at(-2.0, SIDE)
    search = Search(aisle().parts, ViewFacts(aisle().facts, view), target, {Family.ORDINAL}, source)
    found = [
        each
        for each in minimal_expressions(search, np.random.default_rng(0))
        if each.ordinal and each.ordinal.side == ViewSide.AHEAD_LEFT
    ]
    (expression,) = found
    for pattern in source.sentences[:20]:
        text = source.sentence(pattern, expression)
        assert aisle().verifier.check(text, reader(code), view, target) == "", text
        assert aisle().verifier.check(text, reader(code), view, rack_at(1.0, SIDE)), text


def test_the_last_step_of_a_route_along_an_aisle_names_the_rack():
    poses = driven((-8.0, 0.0), (-2.2, 0.0))
    search = RouteSearch(
        SceneRoutes(aisle(), CAMERA), DrivenPath(poses), rack_at(-2.0, SIDE), grammar("en"), np.random.default_rng(0)
    )
    steps = search.steps()
    assert steps[-1].step.kind is StepKind.STOP
    assert steps[-1].step.named is not None


def _seen(start: tuple[float, float, float]) -> SceneView:
    return look(two_rooms().graph, start, CAMERA)


def test_an_object_beyond_a_doorway_is_not_certainly_visible():
    hung = number_at(3.1, -2.9)
    assert two_rooms().graph.hangs[hung]
    assert _seen((3.1, 0.0, -np.pi / 2)).sure[hung]
    assert not _seen((-0.5, -0.3, -0.6)).sure[hung], "through the doorway, from another room"


def test_a_start_close_to_a_doorway_is_in_no_part_of_a_room():
    graph = two_rooms().graph
    assert graph.area_at(-3.0, 0.0) != 0
    assert graph.area_at(-0.4, -0.3) == 0
    view = _seen((-0.4, -0.3, np.pi))
    (expression,) = reader("en").read_phrase("the blue chair in this room")
    assert two_rooms().verifier.evaluate(expression, view).fault == "the room of the start is not known"


def test_the_relation_same_room_is_borderline_across_a_wide_opening():
    walls = room_walls((-6.0, -4.0), (6.0, 4.0))
    stubs = (Box((-0.1, -4.0, 0.0), (0.1, -2.0, 2.5)), Box((-0.1, 2.0, 0.0), (0.1, 4.0, 2.5)))  # an opening of 4 m
    things = (
        Box((-3.2, -0.2, 0.0), (-2.8, 0.2, 0.8), category="chair"),
        Box((2.8, -0.2, 0.0), (3.2, 0.2, 0.8), category="chair"),
        Box((-4.4, 1.0, 0.0), (-4.0, 1.4, 1.2), category="plant"),
    )
    scene = SceneLanguage(build_graph(build_scene((*walls, *stubs, *things), name="wide")))
    assert len(scene.graph.rooms) == 1
    (expression,) = reader("en").read_phrase("the chair in the same room as the plant")
    found = scene.verifier.evaluate(expression, None)
    near, far = (int(np.argmin(np.abs(scene.facts.centre[:, 0] - x))) for x in (-3.0, 3.0))
    assert found.sure == {near}
    assert found.possible == {near, far}
