"""HTML pages of reports and evaluations: one stylesheet, one base template, one palette.

Knows neither datasets nor policies. Importing this does not import Jinja2; `render` does.
"""

from __future__ import annotations

from factory.html.render import data_uri, join_units, render

__all__ = ["data_uri", "join_units", "render"]
