"""Renders the HTML pages of reports and evaluations, with one stylesheet, one base template and one palette.

Does not read datasets or evaluations. Importing this package does not import Jinja2; `render` does.
"""

from __future__ import annotations

from factory.html.render import data_uri, join_units, render

__all__ = ["data_uri", "join_units", "render"]
