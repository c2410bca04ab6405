"""Fixtures that open every renderer of this project, for the contract suites of renderers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from schemas.terms import RendererKind
from workers.render import Renderer
from workers.render.choose import open_renderer

KINDS = [
    pytest.param(("gl", False), id="gl", marks=pytest.mark.gl),
    pytest.param(("tiny", False), id="tiny"),
    pytest.param(("gl", True), id="gl in a process", marks=pytest.mark.gl),
]
"""Renderer, and whether it runs in a separate process."""


@contextmanager
def one_thread(kind: RendererKind, apart: bool) -> Iterator[Renderer]:
    """Opens a renderer that renders with one thread; Mesa reads the setting when the renderer is opened."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LP_NUM_THREADS", "0")
        opened = open_renderer(kind, apart=apart)
    with opened:
        yield opened


@pytest.fixture(scope="module", params=KINDS)
def renderer(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    """Each renderer in turn; it may still have scenes of earlier tests, and a test must not close it."""
    with one_thread(*request.param) as opened:
        yield opened


@pytest.fixture(params=KINDS)
def new_renderer(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    """Each renderer in turn, newly opened and without a scene."""
    with one_thread(*request.param) as opened:
        yield opened
