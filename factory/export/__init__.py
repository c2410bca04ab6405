"""A dataset in the formats people train from: one file or folder a format, behind one base class and a registry.

Reads datasets through `factory.dataset.reader`; never simulates, never changes the dataset.
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
