"""Renders templates to self-contained pages. Escapes every value; an undefined name is an error. Touches no path."""

from __future__ import annotations

import base64
import functools
import re
from typing import TYPE_CHECKING

from factory.html.palette import css_variables

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["data_uri", "join_units", "render"]

_UNIT = re.compile(r"(\d) (?=(?:m|mm|m²|%|pp|Hz)\b|%)")


def render(template: str, **values: object) -> str:
    """Returns a page.

    Args:
        template: file name in `factory/html/templates`.
        values: by name; every text is escaped unless the template says `safe`.

    Raises:
        jinja2.UndefinedError: the template uses a name that `values` lacks.
    """
    return _environment().get_template(template).render(values)


def data_uri(media_type: str, data: bytes) -> str:
    """Returns bytes as a URI, so that a page needs no second file."""
    return f"data:{media_type};base64,{base64.b64encode(data).decode('ascii')}"


def join_units(text: str) -> str:
    """Returns text whose numbers stay on one line with their units."""
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
    environment.globals |= {"light": css_variables(dark=False), "dark": css_variables(dark=True)}
    return environment
