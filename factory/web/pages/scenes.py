"""Pages of the scenes: floor plan with targets and start points, and how many episodes each target has."""

from __future__ import annotations

import math
from collections import Counter

import pyarrow as pa
import pyarrow.compute as pc
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from coordinator.ledger.reading.failures import FailedPlace
from factory.dataset.packages import ScenePackage
from factory.web.context import WebContext, context_of, page, svg_image
from factory.web.floors import Floor, FloorMark
from factory.web.table import TableQuery, page_number
from schemas.errors import FactoryError
from schemas.support.suggest import did_you_mean
from schemas.terms import family_of

_VIEWS = 6
_PAGE_SCENES = 24


def routes() -> list[Route]:
    return [
        Route("/scenes", show_all),
        Route("/scenes/{name}", show),
        Route("/scenes/{name}/floor.svg", draw_floor),
        Route("/scenes/{name}/failures.svg", draw_failures),
    ]


def show_all(request: Request) -> Response:
    """Answers with one page of the list of scenes; `?family=NAME` selects the layouts of a family."""
    context, query = context_of(request), request.query_params
    known_scenes = context.workspace.scenes()
    family, number = query.get("family", ""), page_number(query)
    names = [name for name in known_scenes.packages if family in ("", name, family_of(name))]
    unbuilt = [name for name in known_scenes.unbuilt if family in ("", name, family_of(name))]
    last = max(0, (len(names) - 1) // _PAGE_SCENES)
    counts, fault = _episode_counts(context)
    shown = names[number * _PAGE_SCENES : (number + 1) * _PAGE_SCENES]
    scenes = [(name, counts.get(name, 0)) for name in shown]
    return page(
        request,
        "scenes",
        "Scenes",
        scenes=scenes,
        fault=fault,
        total=len(names),
        unbuilt=unbuilt,
        number=number,
        last=last,
        family=family[:80],
    )


def show(request: Request) -> Response:
    context, name = context_of(request), request.path_params["name"]
    floor = context.floors.of(package_named(context, name))
    by_target, views, fault = _of_scene(context, name)
    targets = [(target, by_target.get(target.target_id, 0)) for target in floor.info.targets]
    failures = _placed(context, name, floor)
    return page(
        request,
        "scene",
        name,
        name=name,
        floor=floor,
        targets=targets,
        fault=fault,
        views=views,
        dot=_dot(floor),
        failures=failures,
        reasons=Counter(failure.reason for failure, _ in failures),
    )


def draw_floor(request: Request) -> Response:
    """Answers with the floor plan; `?view=X,-Y,WIDTH,HEIGHT` selects a part, metres."""
    context = context_of(request)
    floor = context.floors.of(package_named(context, request.path_params["name"]))
    return svg_image(floor.image(_view_box(request.query_params.get("view", ""))))


def draw_failures(request: Request) -> Response:
    """Answers with the floor plan and the locations of failed attempts."""
    context, name = context_of(request), request.path_params["name"]
    floor = context.floors.of(package_named(context, name))
    return svg_image(floor.image(marks=[mark for _, mark in _placed(context, name, floor)]))


def _placed(context: WebContext, name: str, floor: Floor) -> list[tuple[FailedPlace, FloorMark]]:
    """Returns the newest failed attempts with a known location, of the robot or of the target."""
    targets = {target.target_id: target.centroid_m for target in floor.info.targets}
    marks = []
    for failure in context.workspace.failures(name):
        xy_m = failure.xy_m or targets.get(failure.target_id)
        if xy_m is not None:
            mark = FloorMark(failure.reason, (float(xy_m[0]), float(xy_m[1])), failure.xy_m is not None)
            marks.append((failure, mark))
    return marks


def _view_box(text: str) -> str:
    """Returns a view box of four numbers; empty for an empty text.

    Raises:
        HTTPException: the text is not four finite numbers.
    """
    try:
        numbers = [float(part) for part in text.split(",")] if text else []
    except ValueError:
        numbers = [math.nan]
    if len(numbers) not in (0, 4) or not all(map(math.isfinite, numbers)):
        raise HTTPException(400, f"view={text[:40]!r} is not X,-Y,WIDTH,HEIGHT in metres")
    return " ".join(f"{number:.3f}" for number in numbers)


def package_named(context: WebContext, name: str) -> ScenePackage:
    """Returns the package of a scene of the dataset.

    Raises:
        HTTPException: the dataset has no such scene, or its package is not built yet.
    """
    meta = context.workspace.meta()
    digest = meta.scenes.get(name) if meta else None
    if digest is None:
        scenes = context.workspace.scenes()
        if name in scenes.unbuilt:
            raise HTTPException(404, f"{name} is not built yet; the run builds it")
        if name not in scenes.packages:
            raise HTTPException(
                404, f"the dataset has no scene {name[:80]!r}{did_you_mean(name[:80], scenes.packages)}"
            )
        digest = scenes.packages[name]
    return ScenePackage(context.workspace.root, name, digest)


def _episode_counts(context: WebContext) -> tuple[dict[str, int], str]:
    """Returns the number of episodes by scene, and the reason why they cannot be counted, or an empty text."""
    try:
        return _counts(context.workspace.dataset().column("scene")), ""
    except FactoryError as error:
        return {}, str(error)


def _counts(column: pa.Array) -> dict[str, int]:
    """Returns the number of rows by value, without a Python object for each row."""
    counts = pc.value_counts(column)
    names = counts.field("values").cast(pa.string()).to_pylist()
    return dict(zip(names, counts.field("counts").to_pylist(), strict=True))


def _of_scene(context: WebContext, name: str) -> tuple[dict[str, int], list[str], str]:
    """Returns the number of episodes by target, some episodes whose first frames show the scene, and the reason why
    the episodes cannot be read, or an empty text."""
    try:
        table = context.workspace.table()
    except FactoryError as error:
        return {}, [], str(error)
    rows, dataset = table.select(TableQuery({"scene": name})), table.dataset
    targets = _counts(dataset.column("target_id").take(pa.array(rows)))
    step = max(1, len(rows) // _VIEWS)
    return targets, dataset.column("episode_id").take(pa.array(rows[::step][:_VIEWS])).to_pylist(), ""


def _dot(floor: Floor) -> float:
    """Returns the radius of a target on the map, metres."""
    return max(floor.width, floor.height) / 150
