"""Templates: text is escaped, a missing name is an error, and the package contains all templates."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

import jinja2
import pytest

from factory.html import data_uri, join_units, render

VALUES = {"title": "t", "kicker": "k", "run": "r", "badges": [], "digest": None, "contents": []}


def test_text_is_escaped_in_every_context() -> None:
    hostile = '"><script>'
    values = VALUES | {"title": hostile, "run": hostile, "badges": [hostile], "contents": [(hostile, hostile)]}
    page = render("base.html", **values)
    assert "<script" not in page
    assert page.count("&#34;&gt;&lt;script&gt;") == 5


@pytest.mark.parametrize("name", sorted(VALUES))
def test_a_missing_template_value_is_an_error(name: str) -> None:
    values = {key: value for key, value in VALUES.items() if key != name}
    with pytest.raises(jinja2.UndefinedError, match=name):
        render("base.html", **values)


def test_the_page_has_both_colour_schemes_and_forbids_requests() -> None:
    page = render("base.html", **VALUES)
    assert "prefers-color-scheme: dark" in page
    assert "default-src 'none'" in page
    assert page.count("--ink:") == 2


def test_only_drawings_and_rendered_templates_are_inserted_unescaped() -> None:
    folder = Path(str(resources.files("factory.html"))) / "templates"
    unescaped = [
        line.strip()
        for file in sorted(folder.rglob("*.*"))
        for line in file.read_text(encoding="utf-8").splitlines()
        if re.search(r"\|\s*safe\b|autoescape|Markup", line)
    ]
    assert unescaped == [
        '<figure><div role="img" aria-label="{{ panel.alt }}">{{ panel.svg | safe }}</div>'
        "<figcaption>{{ panel.alt }}</figcaption></figure>",
        "{{ drawing | safe }}",
        '<div id="live" data-events="{{ base }}/live">{{ fragment | safe }}</div>',
        '<div class="table" role="group" aria-label="Attempts over time" tabindex="0">{{ chart | safe }}</div>',
        '<h3{% if title | define %} title="{{ title | define }}"{% endif %}>{{ title }}</h3>{{ drawing | safe }}',
    ]


def test_numbers_stay_on_one_line_with_their_units() -> None:
    assert join_units("1 m and 40 %, 3 steps") == "1\u00a0m and 40\u00a0%, 3 steps"
    assert data_uri("image/jpeg", b"poster") == "data:image/jpeg;base64,cG9zdGVy"
