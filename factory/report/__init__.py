"""The report: the paper's figures of any dataset as SVG and PNG, and one HTML page that opens offline.

Importing this needs matplotlib (`minivla-factory[report]`); only `factory report` does.
"""

from __future__ import annotations

from factory.report.folder import Summary
from factory.report.make import make_report, render_report

__all__ = ["Summary", "make_report", "render_report"]
