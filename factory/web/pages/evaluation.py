"""Pages of evaluations: tables of all measures, failures with their videos, and the comparison of two policies."""

from __future__ import annotations

import math
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route

from factory.eval.models.result import Variant
from factory.eval.results.compare import Pair, PairedComparison, compare, pairs_of
from factory.eval.results.page import MeasureTable, comparison_table, main_table, tables_of
from factory.eval.results.publish import pair_folder
from factory.eval.results.summary_text import ASSUMED, INTERVALS, conclusion
from factory.web.context import context_of, page
from factory.web.evaluations import EvaluationReading
from schemas.errors import FactoryError, UsageError
from schemas.support.suggest import did_you_mean

_MOST_FAILURES = 200
"""Number of failures of a policy on the page."""
_CACHED = {"cache-control": "private, max-age=60"}
_KINDS = {".mp4": "video/mp4", ".jpg": "image/jpeg"}


def routes() -> list[Route]:
    here = "/evaluations/{name}"
    return [
        Route("/evaluations", show_all),
        Route(here, show),
        Route(f"{here}/films/{{policy:int}}/{{file}}", film),
        Route(f"{here}/pairs/{{first:int}}/{{second:int}}/{{file}}", film_of_pair),
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
        conclusion=conclusion(compared) if compared else "",
        conclusions=[conclusion(entry) for entry in reading.evaluation.comparisons] if reading.evaluation else [],
        pair_films=_pair_films(reading, compared) if compared else [],
        assumed=ASSUMED,
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
    return FileResponse(video, media_type=_KINDS[f".{kind}"], headers=_CACHED)


def film_of_pair(request: Request) -> Response:
    """Answers with the video of an episode that only one of two policies completed, or with its last picture."""
    reading = _reading(request, request.path_params["name"])
    numbers = [request.path_params["first"], request.path_params["second"]]
    file = Path(request.path_params["file"])
    if max(numbers) < len(reading.policies) and file.suffix in _KINDS:
        runs = [reading.policies[number] for number in numbers]
        rows = [next((row for row in run.results if row.spec_id == file.stem), None) for run in runs]
        path = pair_folder(reading.folder, runs[0].name, runs[1].name) / file.name
        if None not in rows and path.is_file():
            return FileResponse(path, media_type=_KINDS[file.suffix], headers=_CACHED)
    raise HTTPException(404, "this video does not exist; `factory eval --videos N` renders N videos of each pair")


def _pair_films(reading: EvaluationReading, compared: PairedComparison) -> list[tuple[str, Pair]]:
    """Returns the address below the evaluation, without suffix, and the results of each video of a pair."""
    runs = [reading.policy(name) for name in (compared.first, compared.second)]
    numbers = [reading.policies.index(run) for run in runs]
    films = []
    for one, other in pairs_of(runs[0].results, runs[1].results, compared.variant):
        for (first, second), pair in ((numbers, (one, other)), (numbers[::-1], (other, one))):
            folder = pair_folder(reading.folder, pair[0].policy, pair[1].policy)
            if one.success != other.success and (folder / f"{one.spec_id}.mp4").is_file():
                films.append((f"pairs/{first}/{second}/{one.spec_id}", pair))
                break
    return films


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
        # every pair can be selected here, so tests and intervals are corrected for all of them
        number = max(1, math.comb(len(reading.policies), 2))
        return compare(reading.policy(first).results, reading.policy(second).results, variant, number), ""
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
