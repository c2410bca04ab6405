"""Computes the statistics of a dataset: every table of the paper, from the tables of the dataset alone."""

from __future__ import annotations

from factory.stats.compute import compute_statistics, measure_dataset
from factory.stats.statistics import LanguageStatistics, Statistics

__all__ = ["LanguageStatistics", "Statistics", "compute_statistics", "measure_dataset"]
