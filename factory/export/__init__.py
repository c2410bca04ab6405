"""Exports datasets to training formats. Each format is one module with an exporter class, listed in a registry.

Reads datasets through `factory.dataset.reader`. Does not simulate and does not change the dataset.
"""

from __future__ import annotations

from factory.export.base import EpisodeFacts, Exporter, ExportPiece, Finish, Options
from factory.export.execution.estimate import ExportEstimate, estimate_export
from factory.export.execution.report import ExportReport, Skip
from factory.export.execution.run import ExportOrder, ExportProgress, run_export
from factory.export.registry import EXPORTERS, find_exporter

__all__ = [
    "EXPORTERS",
    "EpisodeFacts",
    "ExportEstimate",
    "ExportOrder",
    "ExportPiece",
    "ExportProgress",
    "ExportReport",
    "Exporter",
    "Finish",
    "Options",
    "Skip",
    "estimate_export",
    "find_exporter",
    "run_export",
]
