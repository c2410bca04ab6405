"""Measures footprints as polygons, one object at a time, for the verifier. Does not read words."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple

from schemas.language import thresholds as limit
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.thresholds import Band

_SIDE_SAMPLES = 5


class Truth(IntEnum):
    """Whether a relation holds."""

    NO = 0  # it surely does not hold
    MAYBE = 1  # borderline case
    YES = 2  # it surely holds


def at_most(value: float, band: Band) -> Truth:
    return Truth.YES if value <= band.good else Truth.MAYBE if value < band.bad else Truth.NO


def at_least(value: float, band: Band) -> Truth:
    return Truth.YES if value >= band.good else Truth.MAYBE if value > band.bad else Truth.NO


def angle_between(angle_rad: float, turn_deg: float) -> float:
    """Returns the angle between a direction in radians and a direction in degrees, radians in [0, pi]."""
    return abs(math.remainder(angle_rad - math.radians(turn_deg), 2 * math.pi))


class AlongBox(NamedTuple):
    """Extent of a footprint in the frame of a heading, metres."""

    low: float
    """Smallest distance along the heading."""
    high: float
    """Largest distance along the heading."""
    middle: float
    """Distance of the middle along the heading."""
    near: float
    """Smallest distance from the axis, positive on the given side of it and negative on the other side."""
    far: float
    """Largest distance from the axis, with the same signs."""


class Footprints:
    """Measures the objects of a scene graph and the gaps between them; keeps the measured gaps.

    Points are complex numbers x + iy, metres.

    Args:
        graph: scene graph.
    """

    def __init__(self, graph: SceneGraph) -> None:
        self._objects = graph.objects
        self._floor, self._kinds = graph.floor_m, graph.kinds
        self._outlines = [[complex(x, y) for x, y in each.outline_m] for each in graph.objects]
        self._centres = [_middle(outline) for outline in self._outlines]
        self._radii = [
            max(abs(point - centre) for point in outline)
            for outline, centre in zip(self._outlines, self._centres, strict=True)
        ]
        self._gaps: dict[tuple[int, int], float] = {}
        self._shares: dict[tuple[int, int], float] = {}

    def gap(self, one: int, two: int) -> float:
        """Returns the gap between two footprints, metres."""
        key = (one, two) if one < two else (two, one)
        if key not in self._gaps:
            self._gaps[key] = _polygon_gap(self._outlines[one], self._outlines[two])
        return self._gaps[key]

    def range_from(self, point: tuple[float, float], number: int) -> float:
        """Returns the distance from a point to a footprint, metres."""
        where, outline = complex(*point), self._outlines[number]
        if _contains(outline, where):
            return 0.0
        return min(_to_segment(where, a, b) for a, b in zip(outline, outline[1:] + outline[:1], strict=True))

    def ranges_from(self, point: tuple[float, float], numbers: Iterable[int]) -> dict[int, float]:
        """Returns the distances from a point to footprints, metres; exact for each footprint that may be the nearest.

        The values of other footprints are lower bounds, which are still clearly larger than the smallest distance.
        """
        where = complex(*point)
        apart = {number: abs(self._centres[number] - where) for number in numbers}
        nearest = min((distance + self._radii[number] for number, distance in apart.items()), default=0.0)
        clear = nearest * limit.DISTANCE_RATIO + limit.DISTANCE_GAP_M
        least = {number: distance - self._radii[number] for number, distance in apart.items()}
        return {number: self.range_from(point, number) if low <= clear else low for number, low in least.items()}

    def seen_along(self, eye: tuple[float, float], yaw: float, number: int, sign: float) -> AlongBox:
        """Returns the extent of a footprint along a heading, and to its left (`sign` 1) or right (-1)."""
        turn = cmath.exp(-1j * yaw)
        corners = [(point - complex(*eye)) * turn for point in self._outlines[number]]
        along, aside = [each.real for each in corners], [sign * each.imag for each in corners]
        middle = ((self._centres[number] - complex(*eye)) * turn).real
        return AlongBox(min(along), max(along), middle=middle, near=min(aside), far=max(aside))

    def direction(self, number: int, other: int, eye: tuple[float, float]) -> float:
        """Returns the direction from a landmark to an object relative to the line of sight to the landmark, radians.

        0 is away from the eye, pi/2 to the left.
        """
        landmark = self._centres[other]
        offset, sight = self._centres[number] - landmark, landmark - complex(*eye)
        return cmath.phase(offset / sight) if sight and offset else 0.0

    def is_nearer(self, number: int, other: int, eye: tuple[float, float], landmark: int) -> bool:
        """Returns whether an object is wholly nearer than another one, along the line of sight to a landmark."""
        sight = self._centres[landmark] - complex(*eye)
        near, far = ([(point * sight.conjugate()).real for point in self._outlines[each]] for each in (number, other))
        return max(near) <= min(far)

    def between(self, number: int, first: int, second: int) -> Truth:
        """Returns whether an object is on the strip between two landmarks."""
        start, end = self._centres[first], self._centres[second]
        span = abs(end - start)
        if span < 0.5:
            return Truth.NO
        place = (self._centres[number] - start) / (end - start)  # real part along, imaginary part across
        along, across = min(place.real, 1 - place.real), abs(place.imag)
        return min(
            at_least(along, limit.BETWEEN_ALONG),
            at_most(across, limit.BETWEEN_ACROSS),
            at_most(span, limit.BETWEEN_SPAN_M),
        )

    def rests_on(self, number: int, other: int) -> Truth:
        rest = abs(self._objects[number].low_m[2] - self._objects[other].high_m[2])
        touching = at_most(rest, limit.TOUCH_M)
        return min(touching, at_least(self._share(number, other), limit.OVERLAP)) if touching else Truth.NO

    def holds(self, number: int, thing: int) -> Truth:
        """Returns whether an object has a thing on its top."""
        return self.rests_on(thing, number)

    def carries(self, number: int, *, something: bool) -> Truth:
        """Returns whether an object has something on its flat top, or with `something=False`, whether it is empty."""
        top, outline = self._objects[number].top, self._outlines[number]
        if top is None:
            return Truth.MAYBE
        if not top.above:
            return Truth.NO if something else Truth.YES
        for (x0, y0, z0), (x1, y1, z1) in top.above:
            lies = limit.REST_M[0] <= z0 - top.height_m <= limit.REST_M[1]
            is_large = max(x1 - x0, y1 - y0, z1 - z0) >= limit.THING_M
            if lies and is_large and _contains(outline, complex(x0 + x1, y0 + y1) / 2):
                return Truth.YES if something else Truth.NO
        return Truth.MAYBE

    def is_under(self, number: int, other: int) -> Truth:
        """Returns whether an object is below the top of a landmark and within its outline."""
        each, above = self._objects[number], self._objects[other]
        if each.low_m[2] >= above.high_m[2] or each.high_m[2] >= above.high_m[2] + 0.3:
            return Truth.NO
        inside = at_least(self._share(number, other), limit.OVERLAP)
        is_low = each.high_m[2] < above.high_m[2] + 0.02 and each.low_m[2] - self._floor < limit.TOUCH_M.good
        return min(inside, Truth.YES if is_low and self.rests_on(number, other) is Truth.NO else Truth.MAYBE)

    def is_stacked(self, one: int, two: int) -> bool:
        """Returns whether one object may be on or under the other, or they are at different heights."""
        pairs = ((one, two), (two, one))
        return self.is_apart(one, two) or any(self.rests_on(*pair) or self.is_under(*pair) for pair in pairs)

    def is_apart(self, one: int, two: int) -> bool:
        """Returns whether the lower sides of two objects have very different heights, such as a chair and a sign."""
        return abs(self._objects[one].base_m - self._objects[two].base_m) >= limit.LEVEL_M

    def has_same_base(self, one: int, two: int) -> bool:
        """Returns whether the lower sides of two objects have a similar height."""
        return abs(self._objects[one].base_m - self._objects[two].base_m) < limit.SAME_BASE_M

    def is_supported(self, number: int) -> bool:
        """Returns whether an object may rest on another one."""
        return any(self.rests_on(number, other) for other in range(len(self._objects)) if other != number)

    def is_comparable(self, number: int) -> bool:
        """Returns whether the size of an object may be compared with the sizes of other objects."""
        return self._kinds.of(self._objects[number].kind).sized

    def height(self, number: int) -> float:
        """Returns the height of an object, metres."""
        each = self._objects[number]
        return each.high_m[2] - each.low_m[2]

    def volume(self, number: int) -> float:
        """Returns the volume of the column above the footprint, cubic metres."""
        corners = self._objects[number].outline_m
        sides = zip(corners, (*corners[1:], corners[0]), strict=True)
        return sum(x * next_y - next_x * y for (x, y), (next_x, next_y) in sides) / 2 * self.height(number)

    def _share(self, number: int, other: int) -> float:
        """Returns the share of sample points of an object's bounding rectangle that are in the footprint of another
        one."""
        key = number, other
        if key not in self._shares:
            near = abs(self._centres[number] - self._centres[other]) < self._radii[number] + self._radii[other]
            (x0, y0, _), (x1, y1, _) = self._objects[number].low_m, self._objects[number].high_m
            steps = [(step + 0.5) / _SIDE_SAMPLES for step in range(_SIDE_SAMPLES)] if near else []
            points = [complex(x0 + a * (x1 - x0), y0 + b * (y1 - y0)) for a in steps for b in steps]
            inside = sum(_contains(self._outlines[other], point) for point in points)
            self._shares[key] = inside / len(points) if points else 0.0
        return self._shares[key]


def _middle(outline: list[complex]) -> complex:
    """Returns the centre of the bounding rectangle of an outline."""
    xs, ys = [point.real for point in outline], [point.imag for point in outline]
    return complex(min(xs) + max(xs), min(ys) + max(ys)) / 2


def _cross(a: complex, b: complex) -> float:
    return a.real * b.imag - a.imag * b.real


def _contains(outline: list[complex], point: complex) -> bool:
    """Returns whether a convex polygon, counter-clockwise, contains a point."""
    return all(_cross(b - a, point - a) >= -1e-9 for a, b in zip(outline, outline[1:] + outline[:1], strict=True))


def _to_segment(point: complex, a: complex, b: complex) -> float:
    way = b - a
    length = abs(way) ** 2
    share = 0.0 if length == 0 else max(0.0, min(1.0, ((point - a) * way.conjugate()).real / length))
    return abs(point - a - share * way)


def _polygon_gap(one: list[complex], two: list[complex]) -> float:
    """Returns the smallest distance between two convex polygons; 0 if they overlap."""
    if any(_contains(two, point) for point in one) or any(_contains(one, point) for point in two):
        return 0.0
    edges_one = list(zip(one, one[1:] + one[:1], strict=True))
    edges_two = list(zip(two, two[1:] + two[:1], strict=True))
    if any(_cuts(a, b, c, d) for a, b in edges_one for c, d in edges_two):
        return 0.0
    return min(
        min(_to_segment(point, a, b) for point in one for a, b in edges_two),
        min(_to_segment(point, a, b) for point in two for a, b in edges_one),
    )


def _cuts(a: complex, b: complex, c: complex, d: complex) -> bool:
    return _cross(b - a, c - a) * _cross(b - a, d - a) < 0 and _cross(d - c, a - c) * _cross(d - c, b - c) < 0
