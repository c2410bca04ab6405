"""Statistics of a dataset: every table of the paper, computed from the dataset's tables alone."""

from __future__ import annotations

from factory.stats.compute import compute_statistics, measure_dataset
from factory.stats.model import Statistics

__all__ = ["Statistics", "compute_statistics", "measure_dataset"]
