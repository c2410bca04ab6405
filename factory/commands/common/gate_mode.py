"""Modes of `--gate` and the numbers of the gate. Imports nothing, so that help pages are shown fast."""

from __future__ import annotations

from typing import Literal

GateMode = Literal["auto", "enforce", "report", "skip"]
GATE_ATTEMPTS = 50
"""First attempts per scene, as in the paper."""
MIN_SUCCESS = 0.8
"""Least success rate that passes."""
MIN_EPISODES_FOR_GATE = 4 * GATE_ATTEMPTS
"""Least number of episodes for which `auto` runs the gate. Below it, the gate costs over a quarter of the run."""
