"""Schedules of a training: learning rate with linear warm-up and cosine decay; decay of the moving average.

Pure functions.
"""

from __future__ import annotations

import math

_FINAL_SHARE = 0.02


def learning_rate(step: int, steps: int, peak: float, warmup: int) -> float:
    """Returns the learning rate of a step.

    Args:
        step: Step, from 0 to `steps` - 1.
        steps: Number of steps of the training.
        peak: Maximum learning rate.
        warmup: Number of warm-up steps.
    """
    if step < warmup:
        return peak * (step + 1) / warmup
    share = min(1.0, (step - warmup) / max(1, steps - warmup))
    return peak * (_FINAL_SHARE + (1 - _FINAL_SHARE) * 0.5 * (1 + math.cos(math.pi * share)))


def ema_decay(step: int, limit: float) -> float:
    """Returns the decay of the moving average of the weights at a step; small at first, when the average is noise."""
    return min(limit, (1 + step) / (10 + step))
