"""Time limits of policies. Measures no times."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PolicyLimits"]


@dataclass(frozen=True)
class PolicyLimits:
    """Time limits, passed to every policy on construction."""

    act_timeout_s: float = 10.0
    """Timeout of each action except the first, seconds."""
    load_timeout_s: float = 300.0
    """Timeout of a reset, and of the first action, which may compile models, seconds."""
    reconnect_s: float = 30.0
    """Timeout of reconnecting to a policy server, seconds."""
