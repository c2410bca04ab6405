"""What became of a mishap: it counts when somebody felt it, and only then."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FaultSpan"]


@dataclass
class FaultSpan:
    """A mishap from its beginning to its end.

    A signal is felt when its process got it in the middle of its work; a cut wire once a connection broke or was
    refused, a mute one once an answer was lost; a full disk once a write was refused, a slow one once an fsync waited.
    """

    felt: int = 0
