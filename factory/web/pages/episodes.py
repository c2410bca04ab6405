"""Table of episodes: filters, sorting, text search and pages, all in the URL; computed from the dataset's columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from urllib.parse import urlencode

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from factory.html.measures import PLACES
from factory.web.context import WebContext, context_of, page
from factory.web.frames import first_frames
from factory.web.table import FILTERS, SORTED, EpisodeTable, TableQuery, parse_query, read_first_rows
from factory.web.thumbnails import dataset_version, thumbnail_urls
from schemas.terms import Recording, SuccessMeasure

PAGE_ROWS = 50
"""Number of episodes on a page."""
LARGE_ROWS = 50_000
"""Minimum number of rows of a table whose first rows are shown before the whole table is read. Smaller tables are read
within 0.2 s."""
_PATIENCE_S = 0.1
"""Maximum wait for the first reading of the table, seconds; after it, the page shows the first rows only."""
_SHOWN = (
    ("episode_id", "episode"),
    ("instruction", "instruction"),
    ("scene", "scene"),
    ("split", "split"),
    ("spawn_tier", "tier"),
    ("target_category", "category"),
    ("num_steps", "steps"),
    ("trajectory_length_m", "TL, m"),
)
"""Columns of the table with their titles; the navigation error follows them (`shown_columns`)."""
_ERRORS = {SuccessMeasure.CENTROID: "final_ne_m", SuccessMeasure.SURFACE: "final_surface_m"}


def shown_columns(success: SuccessMeasure) -> tuple[tuple[str, str], ...]:
    """Returns columns and titles of the table. Its navigation error is the one that decides about success."""
    return (*_SHOWN, (_ERRORS[success], f"NE to the {PLACES[success]}, m"))


def routes() -> list[Route]:
    return [Route("/episodes", show)]


def show(request: Request) -> Response:
    context = context_of(request)
    query = parse_query(request.query_params)
    table = context.workspace.table_within(_PATIENCE_S)
    if table is None and context.workspace.site.store is None and query == TableQuery():
        first = read_first_rows(context.workspace.root, PAGE_ROWS)
        if first is not None and first.total >= LARGE_ROWS:
            meta = context.workspace.meta()
            shown = shown_columns(meta.plan.task.success if meta else SuccessMeasure.CENTROID)
            rows = [_cells(row, shown) for row in first.rows]
            return page(request, "first_episodes", "Episodes", total=first.total, heads=shown, rows=rows)
    return _show_table(request, query, table or context.workspace.table())


def _show_table(request: Request, query: TableQuery, table: EpisodeTable) -> Response:
    context = context_of(request)
    marks, base = context.marks.read(), context.workspace.base
    shown = shown_columns(table.dataset.meta.plan.task.success)
    flagged = {name for name, mark in marks.items() if mark.flagged}
    selected = table.select(query, flagged)
    rows = table.rows(selected[query.page * PAGE_ROWS : (query.page + 1) * PAGE_ROWS])
    last = max(0, (len(selected) - 1) // PAGE_ROWS)
    prepare_scenes(context, rows)
    has_pictures = _is_cheap_to_picture(context, table)
    pictures = thumbnail_urls(rows, base, dataset_version(table.dataset.meta)) if has_pictures else [""] * len(rows)
    return page(
        request,
        "episodes",
        "Episodes",
        query=query,
        count=len(selected),
        total=len(table),
        rows=list(
            zip(
                [_cells(row, shown) for row in rows],
                [marks.get(row["episode_id"]) for row in rows],
                pictures,
                strict=True,
            )
        ),
        has_pictures=has_pictures,
        gallery=query_url(f"{base}/gallery", query, page=0),
        heads=list(_heads(f"{base}/episodes", query, shown)),
        choices=[(name, table.values(column), query.filters.get(name, "")) for name, column in FILTERS.items()],
        pages=[
            (text, query_url(f"{base}/episodes", query, page=at), at == query.page)
            for text, at in page_links(query.page, last)
        ],
        last=last,
    )


def prepare_scenes(context: WebContext, rows: Sequence[Mapping[str, Any]]) -> None:
    """Renders the first frame of one episode of each scene of a page, in the background. During a run, only the first
    page does this, for one scene, because each scene takes about a second of CPU time from the run."""
    shown = first_frames([row["scene"] for row in rows], [row["episode_id"] for row in rows])
    if not context.workspace.is_written():
        context.frames.prepare(shown)
    elif not context.frames.has_prepared:
        context.frames.prepare(shown[:1])


def _is_cheap_to_picture(context: WebContext, table: EpisodeTable) -> bool:
    """Returns whether the table shows thumbnails: not where they must be rendered beside a run (`prepare_scenes`)."""
    return table.dataset.meta.plan.record is Recording.FRAMES or not context.workspace.is_written()


def _cells(row: Mapping[str, Any], shown: Sequence[tuple[str, str]]) -> list[tuple[str, bool]]:
    """Returns for each shown column the text of the cell, and whether it is a number."""
    values = [row.get(name) for name, _ in shown]
    return [
        (
            f"{value:.2f}" if isinstance(value, float) else "–" if value is None else str(value),
            not isinstance(value, str),
        )
        for value in values
    ]


def _heads(path: str, query: TableQuery, shown: Sequence[tuple[str, str]]) -> Iterator[tuple[str, str, str]]:
    """Yields title, link and direction of sorting of each column.

    The link is empty if the table cannot be sorted by the column. The direction is empty if the table is not sorted
    by the column.
    """
    for name, title in shown:
        is_sorted = name == query.sort
        direction = "" if not is_sorted else "descending" if query.descending else "ascending"
        link = query_url(path, query, page=0, sort=name, descending=is_sorted and not query.descending)
        yield title, link if name in SORTED else "", direction


def query_url(path: str, query: TableQuery, **changes: Any) -> str:
    """Returns the URL of a page with a selection, after changes of `page`, `sort` or `descending`."""
    state = {"page": query.page, "sort": query.sort, "descending": query.descending, **changes}
    fields = {
        **query.filters,
        "q": query.text,
        "flagged": "1" if query.flagged else "",
        "sort": state["sort"] if state["sort"] != TableQuery.sort else "",
    }
    fields |= {"order": "desc" if state["descending"] else "", "page": state["page"] or ""}
    chosen = urlencode({name: value for name, value in fields.items() if value != ""})
    return f"{path}?{chosen}" if chosen else path


def page_links(here: int, last: int) -> Iterator[tuple[str, int]]:
    """Yields title and number of the pages that a page links to."""
    if here > 0:
        yield from (("first", 0), ("previous", min(here, last + 1) - 1))
    if here < last:
        yield from (("next", here + 1), ("last", last))
