"""Page of one episode: frames, size of the target's mask over time, map, plots, facts, flag and note."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route

from factory.dataset.episode import Episode
from factory.dataset.marks import MOST_NOTE_CHARS, Mark
from factory.html.palette import COLOURS
from factory.visualize.panels import show_ids
from factory.web.charts import WIDTH, draw_lines
from factory.web.context import WebContext, context_of, page, svg_image
from factory.web.forms import read_form
from factory.web.frames import KINDS, SMALL_PX, FrameKey, TooBusy
from factory.web.pages.downloads import download, download_obstacles
from factory.web.pages.find import find_episode
from factory.web.table import TableQuery
from schemas.measure import Goal
from schemas.terms import Recording

_MASKS = 40
"""Maximum number of frames in which the mask of the target is measured."""
_CHOICES = 40
"""Maximum number of episodes that the page offers to show beside its own."""
_MASK_PX = 160
"""Width and height of the frames that are rendered to measure the mask, pixels."""


async def show_frame(request: Request) -> Response:
    """Answers with an image of a frame: `?kind=rgb`, `depth` or `ids`."""
    return await _show(request, is_small=False)


async def show_playback(request: Request) -> Response:
    """Answers with an image of a frame in `SMALL_PX`, for playback: colour as JPEG, `?kind=depth` or `ids` as PNG."""
    return await _show(request, is_small=True)


async def _show(request: Request, is_small: bool) -> Response:
    kind = request.query_params.get("kind", "rgb")
    if kind not in KINDS:
        raise HTTPException(400, f"kind={kind[:40]!r} is not valid; valid kinds: {', '.join(KINDS)}")
    key = FrameKey(request.path_params["episode_id"], request.path_params["t"], kind, is_small)
    store = context_of(request).frames
    try:
        future = await asyncio.to_thread(store.encoded, key)
    except (KeyError, IndexError) as error:
        raise HTTPException(404, str(error.args[0])) from error
    except TooBusy as error:
        raise HTTPException(503, str(error), {"retry-after": "1"}) from error
    data = await asyncio.wrap_future(future)
    return Response(data, media_type=key.media_type, headers={"cache-control": "private, max-age=600"})


def show_mask(request: Request) -> Response:
    """Answers with a plot of the share of the frame that the target covers."""
    episode = find_episode(context_of(request), request.path_params["episode_id"])
    target, last = episode.meta.target_instance_id, len(episode) - 1
    steps = np.unique(np.linspace(0, last, min(last + 1, _MASKS)).round().astype(int)).tolist()
    has_frames = episode.meta.job.record is Recording.FRAMES
    masks = ((episode.ids(t) if has_frames else episode.frame(t, _MASK_PX).ids) == target for t in steps)
    shares = [100 * float(np.mean(mask)) for mask in masks]
    drawing = draw_lines("mask of the target", "% of the frame", shares, last / episode.meta.job.task.control_hz)
    middle, line = "#7d8794", COLOURS["scene1"][1]  # readable on both backgrounds
    style = (
        f"<style>text {{ fill: {middle}; font: 11px sans-serif }} .axis {{ fill: none; stroke: {middle} }} "
        f".line {{ fill: none; stroke: {line}; stroke-width: 1.5 }} .cursor {{ display: none }} "
        "@media (max-width: 25rem) { text { font-size: 17px } }</style>"
    )
    head, _, rest = drawing.partition(">")
    return svg_image(f'{head} xmlns="http://www.w3.org/2000/svg">{style}{rest}')


_RIM_M = 1.5
_LEAST_SPAN_M = 6.0


def routes() -> list[Route]:
    """Returns the routes of the page, its images, downloads and its form."""
    here = "/episodes/{episode_id}"
    return [
        Route(here, show),
        Route(f"{here}/frames/{{t:int}}.png", show_frame),
        Route(f"{here}/playback/{{t:int}}", show_playback),
        Route(f"{here}/mask.svg", show_mask),
        Route(f"{here}/objects.json", list_objects),
        Route(f"{here}/mark", mark, methods=["POST"]),
        Route(f"{here}/download/{{kind}}", download),
    ]


@dataclass(frozen=True)
class TrackView:
    """Trajectory on the map; coordinates are x and -y in metres."""

    box: tuple[float, float, float]
    """West, negative north and side of the shown square, metres."""
    points: str
    """Points of the polyline."""
    poses: str
    """`x,-y,degrees` of each step, separated by spaces, for the page's script."""
    start: tuple[float, float]
    goal: tuple[float, float]
    outline: str
    """Points of the success region."""
    here: tuple[float, float, float]
    """Pose at the shown step: x, -y, clockwise turn in degrees."""

    @property
    def view_box(self) -> str:
        return f"{self.box[0]} {self.box[1]} {self.box[2]} {self.box[2]}"


@dataclass(frozen=True)
class StepView:
    """Sub-instruction on the timeline."""

    number: int
    text: str
    first: int
    """First step of the episode that it describes."""
    last: int
    """Last step of the episode that it describes."""
    x: float
    """Left edge on the timeline, units of its view box."""
    width: float
    """Width on the timeline, units of its view box."""


def show(request: Request) -> Response:
    """Answers with the page; `?t=STEP` selects the shown step, for browsers without JavaScript."""
    context = context_of(request)
    episode = find_episode(context, request.path_params["episode_id"])
    last = len(episode) - 1
    t = min(step_in(request), last)
    summary, hz = episode.summary, episode.meta.job.task.control_hz
    context.frames.prepare([FrameKey(summary.episode_id, t, "rgb", is_small=False)])
    return page(
        request,
        "episode",
        summary.episode_id,
        episode=summary,
        t=t,
        last=last,
        hz=hz,
        track=track_of(episode, t),
        plots=plots_of([episode], last / hz)[0],
        facts=facts_of(episode),
        steps=_steps(episode, last),
        rendered=episode.meta.job.record is not Recording.FRAMES,
        small_px=SMALL_PX,
        mark=context.marks.read().get(summary.episode_id, Mark()),
        choices=similar_episodes(context, episode),
        neighbours=_neighbours(context, summary.index),
        downloads=download_obstacles(),
        most_note=MOST_NOTE_CHARS,
    )


def step_in(request: Request) -> int:
    """Returns the step in the query of a URL; 0 if there is none, or no valid one."""
    given = request.query_params.get("t", "0")
    return int(given) if given.isascii() and given.isdigit() and len(given) < 9 else 0


def similar_episodes(context: WebContext, episode: Episode) -> list[tuple[str, str]]:
    """Returns id and instruction of episodes to show beside an episode: with its target first, then of its scene."""
    table, summary = context.workspace.table(), episode.summary
    scene = {"scene": summary.scene}
    found = [table.select(TableQuery(wanted)) for wanted in ({**scene, "target": summary.target_id}, scene)]
    rows = [row for positions in found for row in table.rows(positions[: _CHOICES + 1])]
    names = {row["episode_id"]: row["instruction"] for row in rows if row["episode_id"] != summary.episode_id}
    return list(names.items())[:_CHOICES]


async def mark(request: Request) -> Response:
    """Stores flag and note of an episode."""
    fields = await read_form(request)
    context, name = context_of(request), request.path_params["episode_id"]
    await run_in_threadpool(find_episode, context, name)
    note = " ".join(fields.get("note", "").split("\r\n")).strip()
    if len(note) > MOST_NOTE_CHARS:
        raise HTTPException(400, f"the note has {len(note)} characters, at most {MOST_NOTE_CHARS} are allowed")
    await run_in_threadpool(context.marks.write, name, Mark(flagged="flagged" in fields, note=note))
    return RedirectResponse(f"{context.workspace.base}/episodes/{name}#mark", 303)


def list_objects(request: Request) -> Response:
    """Answers with the colour of each object in the image of ids, and its name."""
    episode = find_episode(context_of(request), request.path_params["episode_id"])
    instances = episode.instances
    ids = np.array([item.id for item in instances], np.uint16)
    colours = show_ids(ids, episode.meta.target_instance_id).tolist()
    names = [
        f"{item.prim_path.rpartition('/')[2]}" + (f" ({item.category})" if item.category else "") for item in instances
    ]
    objects: dict[str, str] = {}
    for colour, name in zip(colours, names, strict=True):
        key = ",".join(map(str, colour))
        objects[key] = f"{objects[key]} or {name}" if key in objects else name
    return JSONResponse(objects)


def _neighbours(context: WebContext, index: int) -> list[tuple[str, str]]:
    """Returns title and id of the previous and the next episode."""
    table = context.workspace.table()
    indices = table.dataset.column("index").to_numpy(zero_copy_only=False)
    place, names = int(np.searchsorted(indices, index)), table.dataset.column("episode_id")
    around = (("previous", place - 1), ("next", place + 1))
    return [(title, str(names[at])) for title, at in around if 0 <= at < len(names)]


def track_of(episode: Episode, t: int) -> TrackView:
    """Returns the trajectory of an episode on the map, with the robot at step `t`."""
    poses = episode.poses
    yaw = np.degrees(2 * np.arctan2(poses[:, 6], poses[:, 3]))
    rows = np.column_stack([poses[:, 0], -poses[:, 1], -yaw])
    goal = Goal.of_episode(episode.meta)
    outline = np.asarray(goal.outline(), float) * (1, -1)
    points = np.vstack([rows[:, :2], outline])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    span = max(float(np.ptp(points, axis=0).max()) + 2 * _RIM_M, _LEAST_SPAN_M)
    x, y, turn = map(float, rows[t])
    return TrackView(
        box=(round(float(middle[0]) - span / 2, 2), round(float(middle[1]) - span / 2, 2), round(span, 2)),
        points=_points(rows[:, :2]),
        poses=" ".join(f"{a:.3f},{b:.3f},{c:.1f}" for a, b, c in rows.tolist()),
        start=(float(rows[0, 0]), float(rows[0, 1])),
        goal=(goal.centre_m[0], -goal.centre_m[1]),
        outline=_points(outline),
        here=(x, y, turn),
    )


def _points(rows: Any) -> str:
    return " ".join(f"{x:.3f},{y:.3f}" for x, y in rows.tolist())


def plots_of(episodes: Sequence[Episode], end_s: float) -> list[list[tuple[str, str]]]:
    """Returns for each episode title and drawing of its plots over time; the same plots have the same axes.

    Args:
        episodes: the episodes.
        end_s: end of the time axis, seconds; not before the last step of any episode.
    """
    series = [_series(episode) for episode in episodes]
    plots: list[list[tuple[str, str]]] = [[] for _ in episodes]
    for same in zip(*series, strict=True):
        title, unit, _ = same[0]
        whole = np.concatenate([values for _, _, values in same])
        span = float(np.min(whole)), float(np.max(whole))
        for drawn, episode, (_, _, values) in zip(plots, episodes, same, strict=True):
            steps = round(end_s * episode.meta.job.task.control_hz) + 1
            padded = np.pad(values, (0, steps - len(values)), constant_values=np.nan)  # it ends before the axis
            head = title if unit == "token" else f"{title}, {unit}"
            drawn.append((head, draw_lines(title, unit, padded, end_s, span=span)))
    return plots


def _series(episode: Episode) -> tuple[tuple[str, str, NDArray[np.float64]], ...]:
    """Returns title, unit and values at each step of what the plots show."""
    actions, tokens = np.asarray(episode.actions, float), np.asarray(episode.tokens, float)
    return (
        ("speed v", "m/s", actions[:, 0]),
        ("turn rate w", "rad/s", actions[:, 1]),
        ("distance to the target", "m", Goal.of_episode(episode.meta).distances(episode.poses[:, :2])),
        ("token of v", "token", tokens[:, 0]),
        ("token of w", "token", tokens[:, 1]),
    )


def _steps(episode: Episode, last: int) -> list[StepView]:
    """Returns the sub-instructions of the episode; empty if its dataset has no routes."""
    return [
        StepView(
            step.number,
            step.text,
            first=step.start,
            last=min(step.end, last + 1) - 1,
            x=WIDTH * step.start / (last + 1),
            width=WIDTH * (min(step.end, last + 1) - step.start) / (last + 1),
        )
        for step in episode.steps
    ]


def facts_of(episode: Episode) -> list[tuple[str, str]]:
    """Returns name and value of the facts of an episode; measures have their names of `factory.html.measures`."""
    row = episode.summary
    colour = "" if row.colour == "unknown" else f"{row.colour} "  # an object of several colours has no colour name
    return [
        ("scene", row.scene),
        ("split", str(row.split)),
        ("tier", str(row.spawn_tier)),
        ("target", f"{row.target_id} ({colour}{row.target_category})"),
        ("template", row.template_id),
        ("end", str(row.end_reason)),
        ("steps", str(row.num_steps)),
        ("start distance", f"{row.spawn_dist_m:.2f} m"),
        ("trajectory length", f"{row.trajectory_length_m:.2f} m"),
        ("NE to the centroid", f"{row.final_ne_m:.3f} m"),
        ("NE to the footprint", "not recorded" if row.final_surface_m is None else f"{row.final_surface_m:.3f} m"),
        ("attempt", str(row.attempt)),
        ("recording", str(episode.meta.job.record)),
        ("renderer", row.renderer),
        ("worker", row.worker),
        ("digest", row.content_digest),
    ]
