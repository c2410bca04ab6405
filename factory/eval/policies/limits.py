"""What policies may need of their surroundings: the time limits. Holds values only."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PolicyLimits"]


@dataclass(frozen=True)
class PolicyLimits:
    """Given to every policy when it is made."""

    act_timeout_s: float = 10.0
    """Longest time for any other answer."""
    load_timeout_s: float = 300.0
    """Longest time for a reset, and for the first answer, in which models are compiled."""
    reconnect_s: float = 30.0
    """How long a server that went away is waited for."""
