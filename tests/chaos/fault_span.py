"""Records the effect of an injected fault. A fault without an effect is not counted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class FaultSpan:
    """An injected fault from its start to its end.

    A signal has an effect when its process receives it while it works; a cut wire when a connection breaks or is
    refused, a mute wire when a reply is lost; a full disk when a write fails, a slow disk when an fsync waits.
    """

    effects: int = 0
    """Number of observed effects."""
