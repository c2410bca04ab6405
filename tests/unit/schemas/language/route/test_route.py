"""Tests routes of paths whose turns, doorways and landmarks are known, in the furnished scene of two rooms."""

import functools
import math

import numpy as np
import pytest

from schemas.language.language_file import LanguageSpec
from schemas.language.route.compose import RouteComposer
from schemas.language.route.doorways import room_changes
from schemas.language.route.meaning import DrivenPath, RouteStep, RouteText, StepKind
from schemas.language.route.reading import route_reader
from schemas.language.route.segment import divide_path
from schemas.language.route.steps import RouteSearch, SceneRoutes
from schemas.language.route.verify import RouteVerifier
from schemas.language.route.words import clause_of, route_words
from schemas.language.sentence.grammar import LANGUAGES, grammar
from tests.builders.language import CAMERA, driven, number_at, two_rooms

TO_SOFA = ((-4.5, -0.3), (3.2, -0.3), (3.2, 1.4))
"""East through the doorway, then left, and north to the sofa."""
TO_TRASH_CAN = ((3.2, 1.4), (3.2, -0.3), (-2.9, -0.3), (-2.9, -1.7))
"""From the sofa south, right, through the doorway to the west, left, and south to the gray trash can."""


@functools.cache
def place() -> SceneRoutes:
    return SceneRoutes(two_rooms(), CAMERA)


def written(poses: np.ndarray, target: tuple[float, float], seed: int = 0, **keys: object) -> list[RouteText]:
    composer = RouteComposer(LanguageSpec.model_validate(keys))
    return composer.write(place(), poses, number_at(*target), False, np.random.default_rng(seed))


def fault(route: RouteText, poses: np.ndarray, target: tuple[float, float]) -> str:
    scene = two_rooms()
    verifier = RouteVerifier(scene.graph, scene.verifier, place().doorways, CAMERA)
    return verifier.check(route, route_reader(route.language), poses, number_at(*target))


def test_a_path_is_divided_at_its_turns():
    parts = divide_path(DrivenPath(driven(*TO_TRASH_CAN)))
    assert [round(math.degrees(part.turn_rad), -1) for part in parts] == [0, -90, 0, 90, 0]
    assert [part.start for part in parts[1:]] == [part.end for part in parts[:-1]]
    assert (parts[0].start, parts[-1].end) == (0, len(driven(*TO_TRASH_CAN)))


def test_a_doorway_is_found_between_two_rooms_and_nowhere_else():
    (doorway,) = place().doorways
    assert doorway.middle == pytest.approx((0.0, -0.3), abs=0.1)
    assert doorway.width_m == pytest.approx(1.2, abs=0.3)


def test_a_route_names_the_doorway_the_turn_and_the_target_in_their_order():
    poses = driven(*TO_SOFA)
    found = RouteSearch(place(), DrivenPath(poses), number_at(3.5, 2.5), grammar("en"), np.random.default_rng(0))
    steps = found.steps()
    kinds = [each.step.kind for each in steps if each.step.kind in (StepKind.DOOR, StepKind.TURN, StepKind.STOP)]
    assert kinds == [StepKind.DOOR, StepKind.TURN, StepKind.STOP]
    door, turn = (next(each for each in steps if each.step.kind is kind) for kind in kinds[:2])
    assert poses[door.start, 0] < 0 < poses[door.end - 1, 0]
    assert turn.step.side == "left"
    assert turn.step.size == "plain"
    assert steps[-1].step.named.kind == "sofa"


@pytest.mark.parametrize("code", LANGUAGES)
@pytest.mark.parametrize(("corners", "target"), [(TO_SOFA, (3.5, 2.5)), (TO_TRASH_CAN, (-2.9, -2.7))])
def test_the_spans_of_a_verified_route_cover_the_path(code, corners, target):
    poses = driven(*corners)
    routes = written(poses, target, languages=[code], per_episode=3)
    assert routes
    for route in routes:
        edges = [0, *(each.end for each in route.steps)]
        assert [each.start for each in route.steps] == edges[:-1]
        assert edges[-1] == len(poses)
        assert fault(route, poses, target) == ""


def test_turning_around_in_a_doorway_is_described_in_two_steps():
    poses = driven((-2.0, -0.3), (0.8, -0.3), (0.8, -0.9), (0.3, -0.9))
    path = DrivenPath(poses)
    search = RouteSearch(place(), path, number_at(1.2, -2.8), grammar("en"), np.random.default_rng(0))
    turned = np.abs(path.yaw - path.yaw[0])
    start, end = int(np.argmax(poses[:, 0] > -0.6)), int(np.argmax(turned > math.radians(175)))
    (change,) = room_changes(two_rooms().graph, path)
    steps = search._turned(start, end, [change])
    assert [each.step.kind for each in steps] == [StepKind.DOOR, StepKind.TURN]
    assert [steps[0].start, steps[-1].end] == [start, end]
    assert steps[0].end == steps[1].start
    assert steps[-1].step.size == "around"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("left", "right"),
        ("sofa", "plant"),
        ("sofa", "couch and stop, then turn left"),
        ("through the doorway", "towards the sofa"),
        (", then", ", then turn around, then"),
    ],
)
def test_a_changed_word_that_makes_a_route_false_is_rejected(before, after):
    poses = driven(*TO_SOFA)
    for seed in range(12):
        for route in written(poses, (3.5, 2.5), seed, registers=["imperative"]):
            text = route.text.replace(before, after, 1)
            if text != route.text:
                assert fault(route.model_copy(update={"text": text}), poses, (3.5, 2.5)), text
                return
    pytest.fail(f"no route has {before!r}")


def test_a_route_is_rejected_for_the_mirrored_turn_another_target_and_shifted_spans():
    poses = driven(*TO_SOFA)
    (route,) = written(poses, (3.5, 2.5))
    assert fault(route, driven((-4.5, -0.3), (3.2, -0.3), (3.2, -2.0)), (3.5, 2.5))
    assert fault(route, poses, (2.0, 1.0))
    shifted = [each.model_copy(update={"end": each.end - 1}) for each in route.steps]
    assert fault(route.model_copy(update={"steps": tuple(shifted)}), poses, (3.5, 2.5))


@pytest.mark.parametrize("code", LANGUAGES)
def test_every_pattern_of_a_step_is_read_back_with_its_meaning(code):
    words, nouns, read = route_words(code), grammar(code), route_reader(code)
    chair = {"kind": "chair", "colour": "red"}
    meanings = [{"kind": "turn", "size": size, "side": "left"} for size in ("slight", "plain", "sharp")]
    meanings += [
        {"kind": "turn", "size": "around"},
        {"kind": "forward", "metres": 1},
        {"kind": "forward", "metres": 12},
    ]
    meanings += [
        {"kind": "past", "side": "right", "named": chair},
        *({"kind": kind, "named": chair} for kind in ("towards", "stop")),
    ]
    meanings += [{"kind": "door"}, {"kind": "door", "room": "corridor"}]
    meanings += [{"kind": "corner", "side": "right"}, {"kind": "corner", "side": "left", "room": "kitchen"}]
    steps = [RouteStep.model_validate(each) for each in meanings]
    rng = np.random.default_rng(0)
    for form, patterns in words.patterns.items():
        assert {clause_of(step) for step in steps} == {each.clause for each in patterns}
        for step in steps:
            for held_out in (False, True):
                text = nouns.finished(words.clause(step, form, held_out, nouns, rng) + words.full_stop)
                assert read.read_step(text) == [step], text


@pytest.mark.parametrize("code", LANGUAGES)
def test_each_register_has_training_and_held_out_patterns_of_routes(code):
    words = route_words(code)
    both = {(frame.register, frame.held_out) for frame in words.frames}
    assert both == {(register, held_out) for register in LanguageSpec().registers for held_out in (False, True)}
