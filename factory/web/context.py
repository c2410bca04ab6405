"""State that all requests of one application share, and the rendering of a page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from starlette.requests import Request
from starlette.responses import HTMLResponse, Response

from factory.dataset.marks import Marks
from factory.html import render
from factory.web.evaluations import Evaluations
from factory.web.figures.store import StatisticsStore
from factory.web.floors import FloorStore
from factory.web.frames import FrameStore
from factory.web.recent import Recent
from factory.web.thumbnails import ThumbnailStore
from factory.web.workspace import Workspace
from schemas.protocol.administration import AdminReply, AdminRequest

NAVIGATION = (
    ("/gallery", "Gallery"),
    ("/episodes", "Episodes"),
    ("/scenes", "Scenes"),
    ("/statistics", "Statistics"),
    ("/evaluations", "Evaluations"),
    ("/farm", "Farm"),
)
"""Paths and titles of the pages. The home page `/` shows one of them."""


class PageFrame(NamedTuple):
    """What surrounds the content of a page."""

    place: str
    """Location of what the pages show."""
    base: str
    """Prefix of the paths of the pages."""
    navigation: tuple[tuple[str, str], ...]
    """Paths and titles of the pages."""
    overview: tuple[str, str]
    """Path and title of the page that lists everything, for messages."""


class FarmView(NamedTuple):
    """Content of the farm page at one time."""

    fragment: str
    """The part of the page that changes, as HTML."""
    failed_scenes: list[tuple[str, int]]
    """Scenes for which the page draws a map of failures, with the number of failures."""
    is_over: bool = False
    """Whether no job can change its state, or no ledger can be read."""


@dataclass(frozen=True)
class WebContext:
    """State that all requests of one application share."""

    workspace: Workspace
    """The dataset and its run."""
    farm: Recent[FarmView]
    """Content of the farm page, shared by all requests within a few seconds."""
    marks: Marks
    """Flags and notes."""
    frames: FrameStore
    """Encoded frames."""
    thumbnails: ThumbnailStore
    """Small pictures of episodes."""
    administer: Callable[[AdminRequest], AdminReply]
    """Executes an admin request on the run."""
    evaluations: Evaluations
    """Evaluation directories."""
    statistics: StatisticsStore
    """Figures of the report."""
    floors: FloorStore = field(default_factory=FloorStore)
    """Maps of the scenes."""

    @property
    def frame(self) -> PageFrame:
        base = self.workspace.base
        return PageFrame(str(self.workspace.site), base, NAVIGATION, (f"{base}/episodes", "All episodes"))


def context_of(request: Request) -> WebContext:
    """Returns the state of the application that received a request."""
    context: WebContext = request.app.state.context
    return context


def page(request: Request, template: str, title: str, status: int = 200, **values: object) -> Response:
    """Returns a page of the application, of a dataset or of a folder of datasets.

    Args:
        request: the request.
        template: name of the template without folder and suffix.
        title: title of the page.
        status: HTTP status.
        values: additional values of the template.
    """
    scope = request.scope
    frame: PageFrame = request.app.state.context.frame
    place, navigation = frame.place, frame.navigation
    path = scope["path"].removeprefix(scope.get("root_path", ""))
    path = f"/{template}" if path == "/" else path
    here = next((at for at, _ in reversed(navigation) if path == at or path.startswith(f"{at}/")), "")
    text = render(
        f"web/{template}.html",
        title=title,
        place=place,
        base=frame.base,
        run=place.rstrip("/").rpartition("/")[2] or place,
        navigation=navigation,
        here=here,
        may_change=scope["may_change"],
        key=scope["access"].form_key if scope["may_change"] else "",
        **values,
    )
    return HTMLResponse(text, status)


def svg_image(svg: str) -> Response:
    """Returns an SVG image. It may contain a style, but neither scripts nor references."""
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    headers = {"content-security-policy": policy, "cache-control": "private, max-age=60"}
    return Response(svg, media_type="image/svg+xml", headers=headers)
