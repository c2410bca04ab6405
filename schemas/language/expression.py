"""Models of referring expressions: their meaning, independent of the words of a language. Evaluates nothing."""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType
from typing import Annotated

from pydantic import Field, model_validator

from schemas.base import Model, Name


class Relation(StrEnum):
    """Relation of an object to landmarks, to the room or to the start pose; docs/language/reference.md#thresholds."""

    NEXT_TO = "next_to"  # small gap between both footprints, in one room
    LEFT_OF = "left_of"  # left of the landmark, as seen from the start
    RIGHT_OF = "right_of"  # right of the landmark, as seen from the start
    IN_FRONT_OF = "in_front_of"  # between the start and the landmark
    BEHIND = "behind"  # beyond the landmark, as seen from the start
    BETWEEN = "between"  # on the strip between two landmarks
    UNDER = "under"  # below the top of the landmark, within its outline
    ON = "on"  # on the top of the landmark
    ON_WALL = "on_wall"  # above the floor, at a wall
    IN_CORNER = "in_corner"  # close to two perpendicular walls
    EMPTY = "empty"  # nothing is on its flat top
    OCCUPIED = "laden"  # something is on its flat top
    WITH_BESIDE = "with_beside"  # an exact number of objects of a kind is close to it, not to another object with a top
    WITH_ON = "with_on"  # an exact number of objects of a kind is on its top
    THIS_ROOM = "this_room"  # in the room of the start
    IN_ROOM = "in_room"  # in the only room of a type
    SAME_ROOM = "same_room"  # in the room of a landmark
    YOUR_LEFT = "your_left"  # in the left half of the view at the start
    YOUR_RIGHT = "your_right"  # in the right half of the view at the start
    AHEAD = "ahead"  # in the middle of the view at the start
    NEAREST_TO = "nearest_to"  # smallest distance to a landmark
    FARTHEST_FROM = "farthest_from"  # largest distance from a landmark
    NEAREST_YOU = "nearest_you"  # smallest distance to the start


class Size(StrEnum):
    """Superlative of size among the objects that the rest of the expression fits."""

    LARGEST = "largest"  # largest volume above the footprint
    SMALLEST = "smallest"  # smallest volume above the footprint
    TALLEST = "tallest"  # largest height
    LOWEST = "lowest"  # smallest height


class ViewSide(StrEnum):
    """Order in which objects are counted: across the view from one end, or along the heading on one side."""

    LEFT = "left"  # from the left edge of the image
    RIGHT = "right"  # from the right edge of the image
    AHEAD_LEFT = "ahead_left"  # along the left side of the way ahead, such as the racks of an aisle
    AHEAD_RIGHT = "ahead_right"  # along the right side of the way ahead


class Family(StrEnum):
    """Group of features of an expression, which a language file weights."""

    COLOUR = "colour"  # colour of the target
    MATERIAL = "material"  # material of the target
    SUPERCLASS = "superclass"  # a superclass instead of the category
    SIZE = "size"  # superlative of size
    NEAR = "near"  # next to
    VIEW = "view"  # left, right, in front, behind, as seen from the start
    BETWEEN = "between"  # between two landmarks
    SUPPORT = "support"  # on, under
    WALL = "wall"  # on the wall, in the corner
    STATE = "state"  # empty, or with something on it
    COUNT = "count"  # with a number of objects beside or on it
    ROOM = "room"  # this room, type of the room, room of a landmark
    EGO = "ego"  # on your left, on your right, straight ahead
    ORDINAL = "ordinal"  # position, such as second from the left
    NEAREST = "nearest"  # nearest or farthest


ARITY = MappingProxyType(
    dict.fromkeys(Relation, 0)
    | dict.fromkeys((Relation.NEXT_TO, Relation.LEFT_OF, Relation.RIGHT_OF, Relation.IN_FRONT_OF, Relation.BEHIND), 1)
    | dict.fromkeys((Relation.UNDER, Relation.ON, Relation.SAME_ROOM, Relation.NEAREST_TO, Relation.FARTHEST_FROM), 1)
    | dict.fromkeys((Relation.WITH_BESIDE, Relation.WITH_ON), 1)
    | {Relation.BETWEEN: 2}
)
"""Number of landmarks of each relation."""
FROM_VIEW = frozenset({Relation.LEFT_OF, Relation.RIGHT_OF, Relation.IN_FRONT_OF, Relation.BEHIND})
"""Relations between two objects that depend on the start pose."""
OF_VIEWER = frozenset({Relation.YOUR_LEFT, Relation.YOUR_RIGHT, Relation.AHEAD})
"""Relations of an object to the start pose."""
STATES = frozenset({Relation.EMPTY, Relation.OCCUPIED})
"""Relations that hold if an object has nothing, or something, on its top."""
COUNTED = frozenset({Relation.WITH_BESIDE, Relation.WITH_ON})
"""Relations that name a number of objects."""
AHEAD_SIDES = MappingProxyType({ViewSide.AHEAD_LEFT: 1.0, ViewSide.AHEAD_RIGHT: -1.0})
"""Sign of the distance from the way ahead, for each of its sides: positive to the left."""
OF_START = FROM_VIEW | OF_VIEWER | {Relation.THIS_ROOM}
"""Relations that depend on the start pose, except superlatives."""
SUPERLATIVES = frozenset({Relation.NEAREST_TO, Relation.FARTHEST_FROM, Relation.NEAREST_YOU})
"""Relations that select one of the objects that the rest of the expression fits."""
FAMILY = MappingProxyType(
    {
        Relation.NEXT_TO: Family.NEAR,
        Relation.BETWEEN: Family.BETWEEN,
        Relation.UNDER: Family.SUPPORT,
        Relation.ON: Family.SUPPORT,
        Relation.ON_WALL: Family.WALL,
        Relation.IN_CORNER: Family.WALL,
        **dict.fromkeys(STATES, Family.STATE),
        **dict.fromkeys(COUNTED, Family.COUNT),
        **dict.fromkeys((Relation.THIS_ROOM, Relation.IN_ROOM, Relation.SAME_ROOM), Family.ROOM),
        **dict.fromkeys(FROM_VIEW, Family.VIEW),
        **dict.fromkeys(OF_VIEWER, Family.EGO),
        **dict.fromkeys(SUPERLATIVES, Family.NEAREST),
    }
)
"""Family of each relation."""


class Landmark(Model):
    """Object that a relation names."""

    kind: Name
    """Kind or superclass."""
    colour: Name | None = Field(default=None, exclude_if=lambda it: it is None)
    """Colour; `None` if it is not named."""
    definite: bool = True
    """Whether the description fits exactly one object of the scene ("the" instead of "a")."""


class Clause(Model):
    """Relation to landmarks."""

    relation: Relation
    """Name of the relation."""
    landmarks: Annotated[tuple[Landmark, ...], Field(max_length=2)] = Field(default=(), exclude_if=lambda it: not it)
    """Landmarks, in the order in which the sentence names them."""
    room: Name | None = Field(default=None, exclude_if=lambda it: it is None)
    """Type of the room, for `in_room` only."""
    count: Annotated[int, Field(ge=2, le=6)] | None = Field(default=None, exclude_if=lambda it: it is None)
    """Number of objects that the landmark describes, for `with_beside` and `with_on` only."""

    @model_validator(mode="after")
    def _has_its_arguments(self) -> Clause:
        if len(self.landmarks) != ARITY[self.relation]:
            raise ValueError(f"{self.relation} has {ARITY[self.relation]} landmarks, found {len(self.landmarks)}")
        if (self.room is None) == (self.relation is Relation.IN_ROOM):
            raise ValueError("`room` is the argument of in_room")
        if (self.count is None) == (self.relation in COUNTED):
            raise ValueError("`count` is the argument of with_beside and with_on")
        return self


class Ordinal(Model):
    """Position of an object in the view at the start, or along the way ahead."""

    number: Annotated[int, Field(ge=1, le=4)]
    """Position in the order `side`, from 1."""
    side: ViewSide
    """Order in which objects are counted."""


class Expression(Model):
    """Meaning of a referring expression; at most one of size, ordinal and superlative clause selects an object."""

    kind: Name
    """Kind or superclass of the objects."""
    definite: bool = True
    """Whether the expression fits exactly one object; otherwise it fits any object of a set."""
    colour: Name | None = Field(default=None, exclude_if=lambda it: it is None)
    """Colour; `None` if it is not named."""
    material: Name | None = Field(default=None, exclude_if=lambda it: it is None)
    """Material; `None` if it is not named."""
    size: Size | None = Field(default=None, exclude_if=lambda it: it is None)
    """Superlative of size."""
    ordinal: Ordinal | None = Field(default=None, exclude_if=lambda it: it is None)
    """Position in the view, or along the way ahead."""
    clauses: Annotated[tuple[Clause, ...], Field(max_length=4)] = Field(default=(), exclude_if=lambda it: not it)
    """Relations, in the order in which the sentence names them."""

    @property
    def families(self) -> frozenset[Family]:
        """Families of the features. They never include `SUPERCLASS`, because the target determines whether `kind` is a
        superclass."""
        parts = {
            Family.COLOUR: self.colour,
            Family.MATERIAL: self.material,
            Family.SIZE: self.size,
            Family.ORDINAL: self.ordinal,
        }
        named = {family for family, value in parts.items() if value is not None}
        return frozenset(named | {FAMILY[clause.relation] for clause in self.clauses})

    @property
    def selectors(self) -> int:
        """Number of features that select one of several objects."""
        chosen = sum(clause.relation in SUPERLATIVES for clause in self.clauses)
        return chosen + (self.size is not None) + (self.ordinal is not None)

    @model_validator(mode="after")
    def _selects_once(self) -> Expression:
        if self.selectors > 1:
            raise ValueError("an expression has at most one superlative or ordinal")
        return self
