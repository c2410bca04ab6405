"""Report of a dataset: the figures of the paper as SVG and PNG, and a self-contained HTML page.

Importing this package needs matplotlib (`minivla-factory[report]`); only `factory report` and the process that
draws the figures of the web page import it.
"""

from __future__ import annotations

from factory.report.make import Summary, make_report, render_report

__all__ = ["Summary", "make_report", "render_report"]
