"""Thresholds of relations: where they surely hold, and where they surely do not (docs/language.md#thresholds).

Spatial terms have regions of good, acceptable and bad examples (Logan & Sadler 1996). A relation surely holds in the
good region, and surely does not hold in the bad one; the acceptable region between them is borderline. Values without a
source were chosen for this project.
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
"""Gap of footprints for `next_to`, metres."""
DIRECTION_RAD = Band(math.radians(35), math.radians(75))
"""Angle from the exact direction for `left_of` and `right_of`. Goodness falls linearly with
this angle (Regier & Carlson 2001, attention vector sum); SceneVerse (Jia et al. 2024) has sectors of 45 degrees."""
DIRECTION_GAP_M = Band(2.0, 4.0)
"""Gap of footprints for left, right, in front and behind, metres; areas of Sr3D (Achlioptas et al. 2020) have 1 to
4 m."""
FACING_RAD = Band(math.radians(25), math.radians(75))
"""Angle from the exact direction for `in_front_of` and `behind`, which surely hold only if one object is wholly nearer
than the other."""
ALIGNED_RAD = Band(math.radians(5), math.radians(60))
"""Angle between object and landmark in the view for `in_front_of` and `behind`."""
BETWEEN_ALONG = Band(0.25, 0.05)
"""Smallest share of the way from one landmark to the other for `between`."""
BETWEEN_ACROSS = Band(0.2, 0.45)
"""Distance from the line between the landmarks for `between`, as a share of the length of the line."""
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
"""Smallest share of the footprint within that of the landmark for `on` and `under`. `min_supported_area_ratio` of
Sr3D is 0.3."""
THING_M = 0.08
"""Smallest extent of a thing that surely is something on a top, metres."""
REST_M = (-0.03, 0.05)
"""Height of the lower side of a thing above the top on which it surely rests, metres."""
BESIDE_M = Band(0.35, 1.2)
"""Gap of footprints for `with_beside`, metres."""
BESIDE_OTHER_M = 0.3
"""Smallest amount by which a thing beside an object is closer to it than to any other object with a top, metres."""
WALL_BASE_M = Band(0.3, 0.1)
"""Smallest height of the lower side for `on_wall`, metres."""
CORNER_M = Band(0.45, 1.2)
"""Distance to two perpendicular walls for `in_corner`, metres."""
EGO_RAD = Band(math.radians(18), math.radians(6))
"""Smallest angle from the heading for `your_left` and `your_right`."""
EGO_BEHIND_RAD = Band(math.radians(90), math.radians(170))
"""Largest angle from the heading for `your_left` and `your_right`."""
AHEAD_RAD = Band(math.radians(10), math.radians(28))
"""Angle from the heading for `ahead`."""
DISTANCE_GAP_M = 0.5
"""Smallest difference of distances for nearest and farthest, metres; Sr3D's `horizontal_gap` is 0.2."""
DISTANCE_RATIO = 1.25
"""Smallest ratio of distances for nearest and farthest."""
VOLUME_RATIO = 1.5
"""Smallest ratio of volumes for the largest and smallest object."""
HEIGHT_RATIO = 1.2
"""Smallest ratio of heights for the tallest and lowest object."""
SHOWN = 0.4
"""Smallest share of free lines of sight to an object of which a part is surely visible."""
BEARING_GAP_RAD = math.radians(4)
"""Smallest angle between objects that are counted from a side."""
ROW_AHEAD_M = Band(0.7, -0.35)
"""Smallest distance of the middle along the heading, for objects that are counted along the way ahead, metres."""
ROW_ASIDE_M = Band(0.2, 0.0)
"""Smallest distance from the axis of the heading, metres: of the near side for a surely counted object, of the far side
for a borderline case."""
ROW_GAP_M = Band(2.0, 8.0)
"""Largest distance of the near side of a counted object from the axis of the heading, metres."""
ROW_STEP_M = 0.8
"""Smallest distance along the heading between two objects that are counted, metres."""
ROW_HIDDEN_M = 0.3
"""An object is hidden only by objects that are closer to the axis by at least this distance, metres."""
ROW_HIDDEN = 0.5
"""An object is not counted if another one covers at least this share of its length along the heading."""
VISIBLE_M = 10.0
"""Largest distance at which an object counts as surely visible, metres."""
EDGE_RAD = math.radians(4)
"""Width of the band at the edge of the image where visibility is borderline."""
