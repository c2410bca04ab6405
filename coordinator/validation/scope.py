"""Defines how much of a bundle a validation reads. Validates nothing."""

from __future__ import annotations

from enum import StrEnum


class Scope(StrEnum):
    """Part of a bundle that is validated."""

    ALL = "all"  # every frame and measurement
    SAMPLE = "sample"  # one frame and measurement in eight; all arrays
    CLAIM = "claim"  # container, arrays, job, target and content digest; for bundles that the worker has validated
