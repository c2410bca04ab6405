"""Tests the verifier with sentences about a furnished scene whose truth is known, and with its rooms and walls."""

import pytest

from schemas.language.graph.scene_graph import build_graph
from schemas.language.graph.view import look
from schemas.language.sentence.reading import reader
from tests.builders.language import CAMERA, START, number_at, two_rooms
from tests.builders.scene import Box, build_scene, room_walls

RED_NORTH, BLUE_WEST, RED_EAST, GREEN_BEHIND = (-3.0, 1.6), (-2.0, -1.0), (-1.0, 0.4), (-4.6, -2.3)


def check(text: str, place: tuple[float, float], start: tuple[float, float, float] = START) -> str:
    scene = two_rooms()
    return scene.verifier.check(text, reader("en"), look(scene.graph, start, CAMERA), number_at(*place))


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("Go to the sofa.", (3.5, 2.5)),
        ("Go to the white table.", (-1.2, -2.2)),
        ("Go to the green chair.", GREEN_BEHIND),
        ("Go to the chair next to a plant.", None),
        ("Go to the red chair next to the monitor.", RED_NORTH),
        ("Go to the chair nearest to the monitor.", RED_NORTH),
        ("Go to the blue chair in this room.", BLUE_WEST),
        ("Go to the second chair from the left.", RED_EAST),
        ("Go to the chair farthest to the right.", BLUE_WEST),
        ("Go to the table on your right.", (-1.2, -2.2)),
        ("Go to the plant next to the sofa.", None),
        ("Go to the fire extinguisher on the wall.", (3.1, -2.9)),
        ("Go to the monitor on the brown table.", None),  # two tables are brown
        ("Go to the monitor on a brown table.", (-2.95, 2.5)),
        ("Go to the trash can in the corner.", (-5.7, 2.7)),
        ("Go to the trash can in the same room as the sofa.", (2.9, -2.7)),
        ("Go to the lamp.", (-5.75, -2.75)),
    ],
)
def test_a_sentence_fits_the_object_that_a_person_would_choose(text, place):
    numbers = range(len(two_rooms().graph.objects))
    view = look(two_rooms().graph, START, CAMERA)
    fitting = [number for number in numbers if not two_rooms().verifier.check(text, reader("en"), view, number)]
    assert fitting == ([] if place is None else [number_at(*place)])


@pytest.mark.parametrize(
    ("text", "place", "fault"),
    [
        ("Go to the red chair.", RED_NORTH, "it fits 3 objects"),
        ("Go to the green sofa.", (3.5, 2.5), "it does not fit the target"),
        ("Go to the chair next to the trash can.", GREEN_BEHIND, "the landmark trash_can is not unique"),
        ("Go to the lowest sofa.", (3.5, 2.5), "the target is a borderline case"),
        ("Go to the chair in the kitchen.", RED_NORTH, "it does not fit the target"),
        ("Go to the chairs.", RED_NORTH, "the sentence does not match the grammar"),
        ("Go to a green chair.", RED_NORTH, "it does not fit the target"),
    ],
)
def test_a_sentence_that_does_not_fit_only_the_target_is_rejected_with_the_reason(text, place, fault):
    assert check(text, place) == fault


def test_an_indefinite_sentence_fits_every_object_that_it_describes():
    assert [check("Go to a red chair.", place) for place in (RED_NORTH, RED_EAST, (4.0, -1.5))] == ["", "", ""]
    assert check("Go to a red chair.", BLUE_WEST) == "it does not fit the target"


def test_left_and_right_are_those_of_the_viewer():
    east, west = (-5.5, 1.0, 0.0), (-0.6, 0.9, 3.14159)
    text = "Go to the blue chair to the {} of a table as seen from here."
    assert check(text.format("left"), BLUE_WEST, (-5.0, -2.0, 0.0)) != check(
        text.format("right"), BLUE_WEST, (-5.0, -2.0, 0.0)
    )
    assert check("Go to the table on your left.", (-3.0, 2.5), east) == ""
    assert check("Go to the table on your right.", (-3.0, 2.5), west) == ""


def test_a_relation_to_the_view_needs_a_view():
    scene = two_rooms()
    text = "Go to the chair nearest to you."
    assert scene.verifier.check(text, reader("en"), None, number_at(*BLUE_WEST)) == "it needs a view, and none is known"


def test_a_false_premise_names_an_object_that_does_not_exist():
    scene, view = two_rooms(), look(two_rooms().graph, START, CAMERA)
    texts = (
        "Go to the piano.",
        "Go to the green sofa.",
        "Go to the sofa.",
        "Go to the black monitor.",
        "Go to the stool.",
        "Go to.",
    )
    found = [scene.verifier.is_false_premise(text, reader("en"), view) for text in texts]
    # the monitor has no known colour, and a stool can be mistaken for a chair
    assert found == [True, True, False, False, False, False]


def test_the_wall_with_a_door_opening_divides_the_scene_into_two_rooms():
    graph = two_rooms().graph
    assert len(graph.rooms) == 2
    assert graph.room_at(-3.0, 0.0) != graph.room_at(3.0, 0.0) != 0
    assert {graph.objects[number_at(*place)].room for place in (RED_NORTH, BLUE_WEST)} == {graph.room_at(-3.0, 0.0)}


def test_only_objects_at_two_walls_are_in_a_corner():
    graph = two_rooms().graph
    gaps = {place: graph.objects[number_at(*place)].corner_gap_m for place in ((-5.7, 2.7), (-2.9, -2.7), RED_EAST)}
    assert gaps[-5.7, 2.7] < 0.3 < 1.2 < gaps[-2.9, -2.7]
    assert gaps[RED_EAST] > 0.5


def test_a_wall_hides_an_object_and_a_table_in_the_same_room_is_visible():
    graph = two_rooms().graph
    view = look(graph, (-5.0, 2.2, 0.0), CAMERA)
    sofa, table = number_at(3.5, 2.5), number_at(-3.0, 2.5)
    assert view.sure[table]
    assert not view.possible[sofa]


def test_landmarks_without_a_category_are_found_by_the_name_of_their_prim():
    lamp = two_rooms().graph.objects[number_at(-5.75, -2.75)]
    assert (lamp.kind, lamp.target_id) == ("lamp", None)


def test_an_object_beside_the_line_of_sight_is_not_clearly_in_front_of_a_landmark():
    text = "Go to the blue chair in front of the white table as seen from here."
    assert check(text, BLUE_WEST, (-4.0, 0.0, 0.0)) == "the target is a borderline case"


@pytest.mark.parametrize("offset", [0.0, 0.01, 0.02, 0.03, 0.04])
def test_a_picture_in_the_middle_of_a_wall_is_at_the_wall_and_not_in_a_corner(offset):
    walls = room_walls((-6.0, -3.0), (6.0, 3.0))
    wall = Box((offset - 0.06, -3.0, 0.0), (offset + 0.06, 3.0, 2.5))
    pictures = [
        Box((offset + x, -1.6, 1.1), (offset + x + 0.04, 1.6, 1.9), category="whiteboard") for x in (-0.1, 0.06)
    ]
    graph = build_graph(build_scene((*walls, wall, *pictures), name="pictures"))
    boards = [each for each in graph.objects if each.kind == "whiteboard"]
    assert [each.room for each in boards] == [graph.room_at(-3.0, 0.0), graph.room_at(3.0, 0.0)] == [1, 2]
    assert all(each.wall_gap_m <= 0.15 and each.corner_gap_m > 1.0 for each in boards)
