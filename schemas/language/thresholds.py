"""Thresholds of relations: where they surely hold, and where they do not (docs/language/reference.md#thresholds).

Spatial terms have regions of good, acceptable and bad examples (Logan & Sadler 1996). A relation surely holds in the
good region, and surely does not hold in the bad one; the acceptable region between them is borderline. Values without a
source were chosen for this project.

Design: docs/design/language.md#relations-have-three-truth-values.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Band(NamedTuple):
    """Two limits of one measure; small values are good if `good` is less than `bad`, otherwise large values are."""

    good: float
    """The relation surely holds at this value, and at all values on its good side."""
    bad: float
    """The relation surely does not hold at this value, and at all values on its bad side."""


NEXT_TO_M = Band(0.6, 1.6)
"""Gap between the footprints for `next_to`, metres."""
DIRECTION_RAD = Band(math.radians(35), math.radians(75))
"""Angle from the exact direction for `left_of` and `right_of`. Goodness falls linearly with
this angle (Regier & Carlson 2001, attention vector sum); SceneVerse (Jia et al. 2024) has sectors of 45 degrees."""
DIRECTION_GAP_M = Band(2.0, 4.0)
"""Gap between the footprints for left, right, in front and behind, metres; Sr3D (Achlioptas et al. 2020) has areas of
1 to 4 m."""
FACING_RAD = Band(math.radians(25), math.radians(75))
"""Angle from the exact direction for `in_front_of` and `behind`, which surely hold only if one object is wholly nearer
than the other."""
ALIGNED_RAD = Band(math.radians(5), math.radians(60))
"""Angle between object and landmark, as seen from the start, for `in_front_of` and `behind`."""
BETWEEN_ALONG = Band(0.25, 0.05)
"""Minimum distance of the object from each of the two landmarks along the line between them for `between`, as a share
of the length of the line."""
BETWEEN_ACROSS = Band(0.2, 0.45)
"""Distance of the object from the line between the landmarks for `between`, as a share of the length of the line."""
BETWEEN_SPAN_M = Band(5.0, 7.0)
"""Distance between the landmarks for `between`, metres."""
LEVEL_M = 1.0
"""Horizontal relations do not hold between objects whose lower sides differ in height by this or more, metres."""
SAME_BASE_M = 0.5
"""Objects whose lower sides differ in height by this or more are not compared by height, and are not surely in front of
or behind each other, metres."""
TOUCH_M = Band(0.15, 0.3)
"""Vertical gap for `on`, and gap to the wall for `on_wall`, metres; 0.15 is `max_touch_distance` of Sr3D."""
OVERLAP = Band(0.5, 0.1)
"""Minimum share of the object's footprint within the footprint of the landmark for `on` and `under`.
`min_supported_area_ratio` of Sr3D is 0.3."""
THING_M = 0.08
"""Minimum length of the longest side of a thing on a top for the top to be surely not empty, metres."""
REST_M = (-0.03, 0.05)
"""Smallest and largest height of the lower side of a thing above the top on which it surely rests, metres."""
BESIDE_M = Band(0.35, 1.2)
"""Gap between the footprints for `with_beside`, metres."""
BESIDE_OTHER_M = 0.3
"""Smallest amount by which a thing beside an object is closer to it than to any other object with a top, metres."""
WALL_BASE_M = Band(0.3, 0.1)
"""Minimum height of the lower side of the object above the floor for `on_wall`, metres."""
CORNER_M = Band(0.45, 1.2)
"""Distance to two perpendicular walls for `in_corner`, metres."""
EGO_RAD = Band(math.radians(18), math.radians(6))
"""Smallest angle from the heading for `your_left` and `your_right`."""
EGO_BEHIND_RAD = Band(math.radians(90), math.radians(170))
"""Largest angle from the heading for `your_left` and `your_right`."""
AHEAD_RAD = Band(math.radians(10), math.radians(28))
"""Angle from the heading for `ahead`."""
DISTANCE_GAP_M = 0.5
"""Minimum difference between the distance of the nearest (or farthest) object and the distance of every other object,
metres; Sr3D's `horizontal_gap` is 0.2."""
DISTANCE_RATIO = 1.25
"""Minimum ratio between the distance of the nearest (or farthest) object and the distance of every other object."""
VOLUME_RATIO = 1.5
"""Minimum ratio between the volume of the largest (or smallest) object and the volume of every other object."""
HEIGHT_RATIO = 1.2
"""Minimum ratio between the height of the tallest (or lowest) object and the height of every other object."""
SHOWN = 0.4
"""A part of an object is surely visible if at least this share of the lines of sight to the object is free."""
BEARING_GAP_RAD = math.radians(4)
"""Minimum angle between two successive objects that are counted from a side of the view."""
ROW_AHEAD_M = Band(0.7, -0.35)
"""Minimum distance along the heading from the start to the middle of an object that is counted along the way ahead,
metres."""
ROW_ASIDE_M = Band(0.2, 0.0)
"""Minimum distance of an object from the axis of the heading, metres. `good` applies to the near side of a surely
counted object, `bad` to the far side of a borderline case."""
ROW_GAP_M = Band(2.0, 8.0)
"""Largest distance of the near side of a counted object from the axis of the heading, metres."""
ROW_STEP_M = 0.8
"""Minimum distance along the heading between two successive objects that are counted, metres."""
ROW_HIDDEN_M = 0.3
"""An object is hidden only by objects that are closer to the axis of the heading by at least this distance, metres."""
ROW_HIDDEN = 0.5
"""An object is hidden if a surely counted object covers at least this share of the hidden object's length along the
heading."""
VISIBLE_M = 10.0
"""Largest distance at which an object counts as surely visible, metres."""
EDGE_RAD = math.radians(4)
"""Width of the band at the edge of the image where visibility is borderline."""
