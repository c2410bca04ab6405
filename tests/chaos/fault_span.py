"""Records the effect of an injected fault. A fault without an effect is not counted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class FaultSpan:
    """An injected fault from its start to its end.

    Effects that are counted:

    - signal: the process receives it while it works;
    - cut wire: a connection breaks or is refused;
    - muted wire: a reply is lost;
    - full disk: a write fails;
    - slow disk: an fsync is delayed.
    """

    effects: int = 0
    """Number of observed effects."""
