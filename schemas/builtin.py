"""Names of the built-in plans, rigs and appearances, for options and errors. Loads none of them."""

from __future__ import annotations

BUILTIN_PLAN_NAMES = ("demo", "paper", "balanced", "referring")
"""Names of the built-in plans, which `coordinator.expansion.builtin` defines."""
BUILTIN_RIGS = ("paper", "nova-carter", "turtlebot4", "panorama")
"""Names of the built-in rigs; each is a file in `schemas/rig/builtin`."""
BUILTIN_APPEARANCES = ("varied", "full", "light", "materials", "camera", "clutter")
"""Names of the built-in appearances; each is a file in `schemas/appearance/builtin`."""
NO_APPEARANCE = "none"
"""Name for scenes without appearance randomisation, which are rendered as they were compiled."""
DEFAULT_CONTROL_HZ = 60
"""Control rate of the built-in plans, Hz."""
