"""Thresholds of routes (docs/language/reference.md#routes).

Turn concepts have prototypes at 45, 90 and 135 degrees (Klippel et al., Wayfinding choremes, J. Visual Languages and
Computing 16, 2005); sectors around them differ in size (Klippel and Montello, COSIT 2007).
"""

from __future__ import annotations

import math
from types import MappingProxyType

from schemas.language.route.meaning import TurnSize
from schemas.language.thresholds import Band

TURN_RAD = MappingProxyType(
    {
        TurnSize.SLIGHT: (math.radians(25), math.radians(60)),
        TurnSize.PLAIN: (math.radians(60), math.radians(120)),
        TurnSize.SHARP: (math.radians(120), math.radians(150)),
        TurnSize.AROUND: (math.radians(150), math.radians(210)),
    }
)
"""Smallest and largest change of heading of each size of turn."""
CORNER_RAD = (math.radians(30), math.radians(150))
"""Smallest and largest change of heading of a turn in a doorway."""
STRAIGHT_RAD = math.radians(25)
"""Largest range of headings of a straight run; a larger change of heading is a turn."""
UNSAID_RAD = math.radians(60)
"""Largest range of headings during a step that names no turn."""
REVERSED_RAD = math.radians(20)
"""Largest change of heading opposite to the direction of a turn."""
RUN_M = 1.0
"""Smallest length of a straight run, metres."""
METRES = Band(0.25, 0.5)
"""Error of a distance that a step names, as a share of the driven distance."""
METRES_FREE = 0.15
"""Absolute part of the allowed error of a named distance, metres; it is added to the relative part."""
PASS_M = Band(1.8, 3.0)
"""Smallest gap between the centre of the robot and the footprint of an object while the robot passes it, metres."""
BEHIND_M = Band(0.6, -0.3)
"""Distance by which the middle of a passed object is behind the robot at the end of the step, metres."""
BEFORE_M = Band(0.7, 0.3)
"""Distance by which the middle of a passed object is ahead of the robot at the start of the step, metres."""
ASIDE_RAD = math.radians(50)
"""Smallest angle between the heading and the direction to a passed object when it is nearest."""
TOWARDS_RAD = Band(math.radians(6), math.radians(30))
"""Angle between the heading at the start and the direction to the object of `towards`."""
TOWARDS_END_RAD = Band(math.radians(15), math.radians(30))
"""Angle between the heading at the end and the direction to the object of `towards`."""
TOWARDS_SHARE = 0.35
"""Minimum decrease of the distance to the object of `towards` during the step, as a share of the distance at its
start."""
DOORWAY_M = Band(2.2, 3.0)
"""Width of a passage that is called a doorway, metres."""
DOOR_AHEAD_RAD = math.radians(45)
"""Angle from the heading at the start of the step within which another doorway makes the step ambiguous."""
NEXT_DOOR_M = 2.5
"""Another doorway does not make the step ambiguous if it is farther away than the doorway of the step by more than this
distance, metres."""
STOP_M = Band(1.3, 2.0)
"""Gap between the robot at the end and the footprint of the target, metres."""
AMBIGUOUS_M = 7.0
"""Distance within which another visible object that fits the words makes a step ambiguous, metres."""
