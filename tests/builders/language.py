"""Builds a furnished scene of two rooms for tests of language, and changes single words of expressions."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from schemas.config import CameraConfig
from schemas.language.expression import (
    COUNTED,
    FROM_VIEW,
    OF_VIEWER,
    STATES,
    SUPERLATIVES,
    Clause,
    Expression,
    Family,
    Landmark,
    Ordinal,
    Relation,
    Size,
)
from schemas.language.generator.masks import Masks
from schemas.language.generator.parts import ExpressionPart, part_of
from schemas.language.generator.search import ExpressionCandidate, ExpressionHead, Search
from schemas.language.generator.view_facts import ViewFacts
from schemas.language.graph.scene_graph import build_graph
from schemas.language.graph.view import SceneView, look
from schemas.language.scene import SceneLanguage
from schemas.language.sentence.grammar import grammar
from schemas.scene import CompiledScene, Instance
from tests.builders.scene import Box, build_scene, room_walls

CAMERA = CameraConfig()
START = (-5.5, 0.0, 0.0)
"""Pose in the western room, heading east."""
_SIZES = {"chair": (0.5, 0.5, 0.9), "table": (1.2, 0.8, 0.74), "plant": (0.4, 0.4, 1.2), "trash_can": (0.3, 0.3, 0.4)}
_SIZES |= {"sofa": (1.6, 0.8, 0.8), "fire_extinguisher": (0.2, 0.2, 0.5), "monitor": (0.5, 0.2, 0.4)}
_FURNITURE = (
    # the western room, x from -6 to -0.1
    ("chair", -3.0, 1.6, "red"),
    ("chair", -2.0, -1.0, "blue"),
    ("chair", -1.0, 0.4, "red"),
    ("chair", -4.6, -2.3, "green"),
    ("table", -3.0, 2.5, "brown"),
    ("table", -1.2, -2.2, "white"),
    ("plant", -0.5, 2.7, "green"),
    ("trash_can", -2.9, -2.7, "gray"),
    ("trash_can", -5.7, 2.7, "black"),
    # the eastern room, x from 0.1 to 6
    ("chair", 2.0, 1.0, "blue"),
    ("chair", 4.0, -1.5, "red"),
    ("sofa", 3.5, 2.5, "brown"),
    ("table", 5.0, 0.5, "brown"),
    ("plant", 5.6, -2.7, "green"),
    ("plant", 0.5, 2.7, "green"),
    ("trash_can", 2.9, -2.7, "blue"),
    ("fire_extinguisher", 1.2, -2.8, "red"),
)


def furnished_scene() -> CompiledScene:
    """Returns two rooms with a door opening of 1.2 m between them, and furniture with recorded colours."""
    walls = room_walls((-6.0, -3.0), (6.0, 3.0))
    divider = (Box((-0.1, -3.0, 0.0), (0.1, -0.9, 2.5)), Box((-0.1, 0.3, 0.0), (0.1, 3.0, 2.5)))
    boxes = [_standing(kind, x, y) for kind, x, y, _ in _FURNITURE]
    boxes.append(Box((-3.2, 2.4, 0.74), (-2.7, 2.6, 1.14), category="monitor"))  # on the brown table
    lamp, extinguisher = (
        Box((-5.9, -2.9, 0.0), (-5.6, -2.6, 1.6)),
        Box((3.0, -2.98, 0.9), (3.2, -2.8, 1.4), category="fire_extinguisher"),
    )
    scene = build_scene((*walls, *divider, *boxes, extinguisher, lamp), name="two_rooms")
    return _with_words(scene, lamp_id=len(walls) + len(divider) + len(boxes) + 2)


def _standing(kind: str, x: float, y: float) -> Box:
    width, depth, height = _SIZES[kind]
    return Box((x - width / 2, y - depth / 2, 0.0), (x + width / 2, y + depth / 2, height), category=kind)


def _with_words(scene: CompiledScene, lamp_id: int) -> CompiledScene:
    """Sets the colour words of the targets, and the prim path of the lamp, which has no category."""
    colours = [*(colour for *_, colour in _FURNITURE), "unknown", "red"]
    targets = tuple(
        target.model_copy(update={"colour": colour}) for target, colour in zip(scene.info.targets, colours, strict=True)
    )
    instances = tuple(
        Instance(id=each.id, prim_path="/World/SM_FloorLamp_001/Geo_0") if each.id == lamp_id else each
        for each in scene.info.instances
    )
    return dataclasses.replace(scene, info=scene.info.model_copy(update={"targets": targets, "instances": instances}))


def driven(*corners: tuple[float, float], step_m: float = 0.025, step_rad: float = 0.05) -> np.ndarray:
    """Returns the (T, 7) poses of a robot that drives straight between corners, and turns in place at each."""
    poses: list[tuple[float, float, float]] = []
    yaw = math.atan2(corners[1][1] - corners[0][1], corners[1][0] - corners[0][0])
    for start, end in pairwise(corners):
        wanted = math.atan2(end[1] - start[1], end[0] - start[0])
        turn = math.remainder(wanted - yaw, math.tau)
        poses += [(*start, yaw + turn * share) for share in np.linspace(0, 1, 1 + math.ceil(abs(turn) / step_rad))]
        count = math.ceil(math.dist(start, end) / step_m)
        poses += [(*(np.array(start) + (np.array(end) - start) * k / count), wanted) for k in range(1, count + 1)]
        yaw = wanted
    x, y, headings = np.array(poses).T
    zero = np.zeros(len(x))
    return np.column_stack((x, y, zero, np.cos(headings / 2), zero, zero, np.sin(headings / 2)))


@functools.cache
def two_rooms() -> SceneLanguage:
    """Returns the furnished scene, prepared for language."""
    return SceneLanguage(build_graph(furnished_scene()))


def number_at(x: float, y: float) -> int:
    """Returns the number of the object of the furnished scene that is nearest to a point."""
    return min(
        range(len(two_rooms().graph.objects)),
        key=lambda number: math.dist(two_rooms().facts.centre[number].tolist(), (x, y)),
    )


def views(count: int, seed: int = 0) -> list[SceneView]:
    """Returns the views from random starts of the furnished scene."""
    rng = np.random.default_rng(seed)
    spawns = furnished_scene().spawns
    graph = two_rooms().graph
    return [
        look(graph, (*spawns[rng.integers(len(spawns))].tolist(), float(rng.uniform(-math.pi, math.pi))), CAMERA)
        for _ in range(count)
    ]


def search_of(view: SceneView | None, number: int, scene: SceneLanguage | None = None) -> Search:
    """Returns a search for English expressions of an object; the search may use all features."""
    scene, words = scene or two_rooms(), grammar("en")
    seen = None if view is None else ViewFacts(scene.facts, view)
    return Search(scene.parts, seen, number, tuple(Family), words)


def changed(expression: Expression) -> Iterator[Expression]:
    """Yields the expressions that result from changing one word of an expression."""
    for colour in ("red", "blue", "green", "brown", "gray", "black", "white"):
        if expression.colour not in (None, colour):
            yield expression.model_copy(update={"colour": colour})
    for material in ("wood", "metal", "glass"):
        if expression.material not in (None, material):
            yield expression.model_copy(update={"material": material})
    for kind in ("chair", "table", "plant", "trash_can", "sofa", "seat", "container"):
        if kind != expression.kind:
            yield expression.model_copy(update={"kind": kind})
    if expression.size is not None:
        yield from (expression.model_copy(update={"size": size}) for size in Size if size is not expression.size)
    if expression.ordinal is not None:
        other = _OTHER_SIDE[expression.ordinal.side]
        number = expression.ordinal.number
        yield expression.model_copy(update={"ordinal": Ordinal(number=number, side=other)})
        if number > 1:
            yield expression.model_copy(update={"ordinal": Ordinal(number=5 - number, side=expression.ordinal.side)})
    for place, clause in enumerate(expression.clauses):
        for one in _changed_clause(clause):
            clauses = (*expression.clauses[:place], one, *expression.clauses[place + 1 :])
            yield expression.model_copy(update={"clauses": clauses})


_OTHER_SIDE = {"left": "right", "right": "left", "ahead_left": "ahead_right", "ahead_right": "ahead_left"}
_EXCHANGED = (
    frozenset({Relation.NEXT_TO, Relation.UNDER, Relation.ON}) | FROM_VIEW,
    OF_VIEWER,
    frozenset({Relation.NEAREST_TO, Relation.FARTHEST_FROM}),
    STATES,
    COUNTED,
)


def _changed_clause(clause: Clause) -> Iterator[Clause]:
    for group in _EXCHANGED:
        if clause.relation in group:
            yield from (clause.model_copy(update={"relation": other}) for other in group - {clause.relation})
    if clause.count is not None:
        yield from (clause.model_copy(update={"count": count}) for count in range(2, 7) if count != clause.count)
    counted = grammar("en").plurals
    for place, landmark in enumerate(clause.landmarks):
        for kind in ("table", "plant", "trash_can", "sofa", "lamp") if clause.count is None else counted:
            if kind != landmark.kind:
                landmarks = (*clause.landmarks[:place], _renamed(landmark, kind), *clause.landmarks[place + 1 :])
                yield clause.model_copy(update={"landmarks": landmarks})


def _renamed(landmark: Landmark, kind: str) -> Landmark:
    return landmark.model_copy(update={"kind": kind})


def is_false_or_ambiguous(expression: Expression, search: Search) -> bool:
    """Returns whether an expression certainly does not fit the target, or certainly fits another object too.

    Uses the masks of the generator, not the verifier.
    """
    facts = search.facts
    masks = facts.described(expression.kind, expression.colour, expression.material)
    parts: tuple[ExpressionPart, ...] = ()
    for clause in expression.clauses:
        if clause.relation in SUPERLATIVES:
            continue
        found = masks_of(clause, search)
        if found is None:
            return True  # the clause names a landmark that does not exist
        masks = masks.both(found)
        parts += (part_of(clause, found),)
    if not masks.possible[search.number]:
        return True
    if expression.selectors:
        return _is_wrongly_selected(expression, search, masks)
    others = masks.sure.copy()
    others[search.number] = False
    return bool(others.any())


def _is_wrongly_selected(expression: Expression, search: Search, masks: Masks) -> bool:
    """Returns whether the selector of an expression (size, ordinal or superlative) selects an object other than the
    target."""
    chosen = next((clause for clause in expression.clauses if clause.relation in SUPERLATIVES), None)
    wanted = expression.size, expression.ordinal, chosen
    for number in np.flatnonzero(masks.sure).tolist():
        if number != search.number:
            other = dataclasses.replace(search, number=number)
            if any(
                one.selector == wanted
                for one in other._selectors(ExpressionCandidate(_head(expression, masks)), None, masks)
            ):
                return True
    return False


def _head(expression: Expression, masks: Masks) -> ExpressionHead:
    return ExpressionHead(expression.kind, expression.colour, masks, False, expression.material)


def masks_of(clause: Clause, search: Search) -> Masks | None:
    """Returns the objects for which a clause holds; `None` if a landmark does not exist."""
    facts, view, graph = search.facts, search.view, search.facts.graph
    fitting = [facts.described(landmark.kind, landmark.colour) for landmark in clause.landmarks]
    if any(not each.possible.any() for each in fitting):
        return None
    if clause.relation in facts.alone:
        return facts.alone[clause.relation]
    if view is not None and clause.relation in view.ego:
        return view.ego[clause.relation]
    if clause.count is not None:
        return facts.counted(clause.relation, clause.landmarks[0].kind, clause.count)
    if clause.relation is Relation.THIS_ROOM:
        assert view is not None
        return facts.in_room(view.view.room, view.view.area)
    if clause.relation is Relation.IN_ROOM:
        return facts.in_typed_room(graph.unique_room(str(clause.room)))
    if clause.relation is Relation.SAME_ROOM:
        row = int(np.flatnonzero(fitting[0].possible)[0])
        return Masks(facts.same_room.sure[row], facts.same_room.possible[row])
    if clause.relation is Relation.BETWEEN:
        return facts.between(*(int(np.flatnonzero(each.possible)[0]) for each in fitting))
    pairs = {Relation.NEXT_TO: facts.next_to, **facts.support, **(view.relative if view is not None else {})}
    if clause.relation in pairs:
        masks = pairs[clause.relation]
        return Masks(masks.sure[fitting[0].sure].any(axis=0), masks.possible[fitting[0].possible].any(axis=0))
    raise NotImplementedError(clause.relation)
