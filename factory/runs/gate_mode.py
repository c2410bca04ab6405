"""Modes of `--gate` and the numbers of the gate. Imports nothing, so help pages are shown fast."""

from __future__ import annotations

from typing import Literal

GateMode = Literal["auto", "enforce", "report", "skip"]
GATE_ATTEMPTS = 50
"""First attempts per scene, as in the paper."""
MIN_SUCCESS = 0.8
"""Minimum success rate to pass the gate."""
MIN_EPISODES_FOR_GATE = 4 * GATE_ATTEMPTS
"""Minimum number of episodes of a scene for which `auto` runs the gate. With fewer episodes, the gate costs more than a
quarter of the run."""
