"""Pages of evaluations: tables of all measures, failures with their videos, and the comparison of two policies."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.compute as pc
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route

from factory.eval.models.result import Variant
from factory.eval.results.compare import PairedComparison, compare
from factory.eval.results.page import MeasureTable, comparison_table, main_table, tables_of
from factory.eval.results.summary_text import INTERVALS
from factory.web.context import context_of, page
from factory.web.evaluations import EvaluationReading
from schemas.errors import FactoryError, UsageError
from schemas.support.suggest import did_you_mean

_MOST_FAILURES = 200
"""Number of failures of a policy on the page."""
_KINDS = {".mp4": "video/mp4", ".jpg": "image/jpeg"}


def routes() -> list[Route]:
    here = "/evaluations/{name}"
    return [
        Route("/evaluations", show_all),
        Route(here, show),
        Route(f"{here}/films/{{policy:int}}/{{file}}", film),
    ]


def show_all(request: Request) -> Response:
    """Answers with the list of evaluations and their main metrics; a damaged one is listed with its error."""
    known = context_of(request).evaluations
    entries: list[tuple[str, EvaluationReading | None, MeasureTable | None, str]] = []
    for name in known.names:
        try:
            reading = known.read(name)
        except FactoryError as error:
            entries.append((name, None, None, str(error)))
        else:
            table = main_table(reading.evaluation.policies) if reading.evaluation else None
            entries.append((name, reading, table, ""))
    return page(request, "evaluations", "Evaluations", evaluations=entries)


def show(request: Request) -> Response:
    """Answers with one evaluation; `?first=A&second=B&variant=original` compares two policies."""
    name = request.path_params["name"]
    reading = _reading(request, name)
    compared, refusal = _compared(request, reading)
    return page(
        request,
        "evaluation",
        name,
        name=name,
        reading=reading,
        intervals=INTERVALS,
        main=main_table(reading.evaluation.policies) if reading.evaluation else None,
        tables=list(tables_of(reading.evaluation.policies)) if reading.evaluation else [],
        compared=compared,
        comparison=comparison_table(compared) if compared else None,
        refusal=refusal,
        query=request.query_params,
        variants=list(Variant),
        most=_MOST_FAILURES,
        known=_archived(
            request, [row.spec_id for policy in reading.policies for row in policy.failures[:_MOST_FAILURES]]
        ),
    )


def film(request: Request) -> Response:
    """Answers with the video of a failure or with its last picture."""
    reading, file = _reading(request, request.path_params["name"]), request.path_params["file"]
    number = request.path_params["policy"]
    spec, dot, kind = file.rpartition(".")
    policy = reading.policies[number] if number < len(reading.policies) else None
    video = policy.video(spec, f".{kind}") if policy is not None and f"{dot}{kind}" in _KINDS else None
    if video is None:
        raise HTTPException(
            404, "this video does not exist; `factory eval --videos N` renders videos of N failures of each policy"
        )
    return FileResponse(video, media_type=_KINDS[f".{kind}"], headers={"cache-control": "private, max-age=60"})


def _reading(request: Request, name: str) -> EvaluationReading:
    known = context_of(request).evaluations
    try:
        return known.read(name)
    except KeyError as error:
        near = did_you_mean(name[:80], known.names)
        raise HTTPException(404, f"no evaluation is named {name[:80]!r}{near}") from error


def _compared(request: Request, reading: EvaluationReading) -> tuple[PairedComparison | None, str]:
    """Returns the comparison that a query asks for, or the reason why there is none."""
    query = request.query_params
    first, second = query.get("first", ""), query.get("second", "")
    if not first or not second:
        return None, ""
    try:
        variant = Variant(query.get("variant", "original"))
        return compare(reading.policy(first).results, reading.policy(second).results, variant), ""
    except ValueError as error:
        raise UsageError(f"variant={query['variant'][:40]!r} is not valid; valid: {', '.join(Variant)}") from error
    except UsageError as error:
        return None, str(error)


def _archived(request: Request, names: list[str]) -> set[str]:
    """Returns the names that are episodes of the dataset; failures in these episodes link to them."""
    try:
        held = context_of(request).workspace.dataset().column("episode_id")
    except FactoryError:
        return set()
    is_known = pc.is_in(pa.array(names, pa.string()), value_set=held.cast(pa.string())).to_pylist()
    return {name for name, known in zip(names, is_known, strict=True) if known}
