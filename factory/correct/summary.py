"""Counts of the steps of corrections: who acted, how many labels and takeovers. Reads the episodes, writes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np

from factory.dataset.reader import Dataset
from schemas.storage.place import Place
from schemas.terms import Driver


def describe_corrections(root: Place) -> dict[str, Any]:
    """Returns the number of steps, labels and takeovers of a dataset of corrections, and the shares of the drivers."""
    by, labels, takeovers = np.zeros(len(Driver), int), 0, 0
    for episode in Dataset(root):
        with episode:
            corrections = episode.corrections
        if corrections is None:
            continue
        drivers = corrections.drivers
        by += np.bincount(drivers, minlength=len(Driver))
        labels += int(np.isfinite(corrections.expert_actions).all(axis=1).sum())
        takeovers += int(((drivers[1:] == Driver.EXPERT) & (drivers[:-1] == Driver.POLICY)).sum())
    steps = int(by.sum())
    shares = {driver.name.lower(): float(by[driver]) / max(1, steps) for driver in Driver}
    return {"steps": steps, "driven_by": shares, "labels": labels, "takeovers": takeovers}
