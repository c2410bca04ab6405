"""Chooses the size of the pictures and the number of epochs that fit into a time, from measured training steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from factory.train.behaviour_cloning import TrainCallbacks, TrainOrder, frames_of_order
from factory.train.checkpoint import STATE, read_checkpoint
from factory.train.frames import TrainingFrames
from factory.train.options import BcOptions
from factory.train.torch_import import choose_device
from factory.train.vocabulary import vocabulary

_SIZES = (160, 128, 64)
"""Sizes to choose from; each is a multiple of the largest stride of the encoders, 32."""
_FEWEST_EPOCHS, _MOST_EPOCHS = 6, 40
_USED = 0.9
"""Share of the time for training steps; the rest is for rendering, validation and checkpoints."""
_VALIDATION_COST = 0.35
"""Time of a validation frame as a share of that of a training frame."""
_STEPS = 3


def choose(hours: float, frames: int, validation: int, rate_at: Callable[[int], float]) -> tuple[int, int]:
    """Returns the largest size with at least six epochs in a time, else the smallest, and its epochs, at most 40.

    Args:
        hours: time of the training, hours.
        frames: number of training frames.
        validation: number of validation frames.
        rate_at: function that returns the training frames per second at a size.
    """
    for size in _SIZES:
        epoch_s = (frames + _VALIDATION_COST * validation) / rate_at(size)
        epochs = int(_USED * 3600 * hours / epoch_s)
        if epochs >= _FEWEST_EPOCHS:
            break
    return size, min(max(1, epochs), _MOST_EPOCHS)


def fit_to_budget(order: TrainOrder, callbacks: TrainCallbacks, hours: float) -> TrainOrder:
    """Returns a training order with the size and the epochs that fit into a time; an interrupted training keeps them.

    Args:
        order: training order.
        callbacks: its callbacks; `caching` is called while frames are labelled.
        hours: time of the training, hours.

    Raises:
        UsageError: PyTorch or the weights of the encoder are not installed, or the split has no episodes.
        WorldError: A file cannot be read.
    """
    device, state = choose_device(order.device), order.out / STATE
    if state.exists():
        former = read_checkpoint(state).meta.options
        return replace(order, options=order.options.model_copy(update={"size": former.size, "epochs": former.epochs}))
    counts: list[int] = []

    def rate_at(size: int) -> float:
        options = order.options.model_copy(update={"size": size})
        # frames that are kept in memory would be rendered in advance
        train, val = frames_of_order(replace(order, options=options, memory_bytes=0), callbacks)
        counts[:] = [len(train), len(val) if val else 0]
        return _measured_rate(train, options, device)

    first = rate_at(_SIZES[0])  # also counts the frames
    size, epochs = choose(hours, counts[0], counts[1], lambda size: first if size == _SIZES[0] else rate_at(size))
    return replace(order, options=order.options.model_copy(update={"size": size, "epochs": epochs}))


def _measured_rate(train: TrainingFrames, options: BcOptions, device: Any) -> float:
    """Returns the training frames per second of a few steps, with their rendering."""
    from factory.train.fit import BcTraining, TrainingLimits

    words = vocabulary(episode.instruction for episode in train.index.episodes)
    limits = TrainingLimits(train.index.max_speed_mps, train.index.max_yaw_rate_rps)
    training = BcTraining(options, words, limits, device)
    starts = range(0, (1 + _STEPS) * options.batch, options.batch)
    batches = [np.unique(np.arange(first, first + options.batch) % len(train)) for first in starts]
    training.try_step(train, batches[0])  # loads scenes and allocates memory
    start_s = time.monotonic()
    for rows in batches[1:]:
        training.try_step(train, rows)
    return sum(len(rows) for rows in batches[1:]) / max(1e-6, time.monotonic() - start_s)
