"""The learning rate over a training: a short rise, then half a cosine down. Pure."""

from __future__ import annotations

import math

__all__ = ["ema_decay", "learning_rate"]

_FINAL_SHARE = 0.02


def learning_rate(step: int, steps: int, peak: float, warmup: int) -> float:
    """Returns the rate of a step.

    Args:
        step: from 0 to `steps` - 1.
        steps: of the whole training.
        peak: highest rate.
        warmup: steps of the rise.
    """
    if step < warmup:
        return peak * (step + 1) / warmup
    share = min(1.0, (step - warmup) / max(1, steps - warmup))
    return peak * (_FINAL_SHARE + (1 - _FINAL_SHARE) * 0.5 * (1 + math.cos(math.pi * share)))


def ema_decay(step: int, limit: float) -> float:
    """Returns how much of the running mean of the weights a step keeps; little at first, when it holds only noise."""
    return min(limit, (1 + step) / (10 + step))
