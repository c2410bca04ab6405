"""Every renderer of the product, open, for the contracts of renderers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from workers.render import Renderer
from workers.render.choose import open_renderer

KINDS = [
    pytest.param(("gl", False), id="gl", marks=pytest.mark.gl),
    pytest.param(("tiny", False), id="tiny"),
    pytest.param(("gl", True), id="gl apart", marks=pytest.mark.gl),
]
"""Renderer, and whether it runs in a separate process."""


@pytest.fixture(params=KINDS)
def renderer(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Renderer]:
    """Every renderer in turn, open, with one thread."""
    monkeypatch.setenv("LP_NUM_THREADS", "0")
    kind, apart = request.param
    with open_renderer(kind, apart=apart) as opened:
        yield opened
