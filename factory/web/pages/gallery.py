"""Gallery of episodes: pictures with instructions, selected as in the table of episodes. Serves the thumbnails."""

from __future__ import annotations

import asyncio
import contextlib

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from factory.web.context import context_of, page
from factory.web.frames import TooBusy
from factory.web.pages import farm
from factory.web.pages.episodes import page_links, query_url
from factory.web.pages.find import find_episode
from factory.web.table import FirstRows, TableQuery, parse_query, read_first_rows
from factory.web.thumbnails import THUMBNAIL_PX, dataset_version, thumbnail_urls
from schemas.errors import FactoryError

PAGE_CARDS = 24
"""Number of episodes on a page."""
_PATIENCE_S = 0.1
"""Maximum wait for the first reading of the table, seconds; after it, the first page shows the first rows."""


def routes() -> list[Route]:
    return [
        Route("/", show_home),
        Route("/gallery", show),
        Route("/episodes/{episode_id}/thumbnail.jpg", show_thumbnail),
    ]


def show_home(request: Request) -> Response:
    """Answers with the gallery of a dataset whose run is over, otherwise with the farm page."""
    context = context_of(request)
    if context.farm.get().is_over and not context.workspace.is_written():
        with contextlib.suppress(FactoryError):  # without tables, the farm page shows what the ledger knows
            return draw(request, TableQuery())
    return farm.show(request)


def show(request: Request) -> Response:
    """Answers with the episodes that the URL selects."""
    return draw(request, parse_query(request.query_params))


def draw(request: Request, query: TableQuery) -> Response:
    """Returns the page of the selected episodes.

    Raises:
        FactoryError: the tables are missing or damaged.
    """
    context = context_of(request)
    found, base = _find(request, query), context.workspace.base
    last = max(0, (found.total - 1) // PAGE_CARDS)
    pictures = thumbnail_urls(found.rows, base, dataset_version(context.workspace.meta()))
    return page(
        request,
        "gallery",
        "Gallery",
        cards=list(zip(found.rows, pictures, strict=True)),
        total=found.total,
        side_px=THUMBNAIL_PX,
        query=query,
        last=last,
        table=query_url(f"{base}/episodes", query, page=0),
        pages=[(text, query_url(f"{base}/gallery", query, page=at)) for text, at in page_links(query.page, last)],
    )


def _find(request: Request, query: TableQuery) -> FirstRows:
    """Returns the rows of the page, and the number of rows on all pages."""
    context = context_of(request)
    table = context.workspace.table_within(_PATIENCE_S)
    if table is None and context.workspace.site.store is None and query == TableQuery():
        first = read_first_rows(context.workspace.root, PAGE_CARDS)
        if first is not None:
            return first
    table = table or context.workspace.table()
    flagged = {name for name, mark in context.marks.read().items() if mark.flagged} if query.flagged else ()
    selected = table.select(query, flagged)
    return FirstRows(table.rows(selected[query.page * PAGE_CARDS : (query.page + 1) * PAGE_CARDS]), len(selected))


async def show_thumbnail(request: Request) -> Response:
    """Answers with the thumbnail of an episode. Browsers keep it if the URL names a content (`thumbnail_urls`)."""
    context, name = context_of(request), request.path_params["episode_id"]
    try:
        future = await asyncio.to_thread(lambda: context.thumbnails.encoded(context.workspace.dataset()[name]))
    except KeyError:
        await asyncio.to_thread(find_episode, context, name)  # names the nearest episode
        raise
    except TooBusy as error:
        raise HTTPException(503, str(error), {"retry-after": "1"}) from error
    data = await asyncio.wrap_future(future)
    lasting = "private, max-age=31536000, immutable" if "of" in request.query_params else "private, max-age=60"
    return Response(data, media_type="image/jpeg", headers={"cache-control": lasting})
