"""Renders the HTML pages of reports and evaluations, with one stylesheet, one base template and one palette.

Pages are self-contained. All values are escaped; undefined names are errors. Does not read datasets or evaluations and
writes no files. Importing this package does not import Jinja2; `render` does.
"""

from __future__ import annotations

import base64
import functools
import re
from typing import TYPE_CHECKING

from factory.html.measures import define, definitions_of
from factory.html.palette import css_variables
from schemas.support.shell import quoted

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["compile_templates", "data_uri", "join_units", "render"]

_UNIT = re.compile(r"(\d) (?=(?:m|mm|m²|%|pp|Hz)\b|%)")


def render(template: str, **values: object) -> str:
    """Renders a page.

    Args:
        template: file name in `factory/html/templates`.
        values: values by name; text is escaped unless the template marks it as `safe`.

    Raises:
        jinja2.UndefinedError: the template uses a name that is not in `values`.
    """
    return _environment().get_template(template).render(values)


def compile_templates(folder: str) -> None:
    """Compiles the templates of a folder of `factory/html/templates` in advance, so no request waits for this."""
    for name in _environment().list_templates(filter_func=lambda name: name.startswith(f"{folder}/")):
        _environment().get_template(name)


def data_uri(media_type: str, data: bytes) -> str:
    """Returns bytes as a data URI, so the page is self-contained."""
    return f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"


def join_units(text: str) -> str:
    """Replaces the spaces between numbers and units by no-break spaces."""
    return _UNIT.sub("\\1\u00a0", text)


@functools.cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("factory.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["units"] = join_units
    environment.filters |= {"define": define, "definitions": definitions_of, "quoted": quoted}
    environment.globals |= {"light": css_variables(dark=False), "dark": css_variables(dark=True)}
    return environment
