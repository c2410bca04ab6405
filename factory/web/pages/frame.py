"""Images of an episode: frames, and the size of the target's mask over time."""

from __future__ import annotations

import asyncio

import numpy as np
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from factory.html.palette import COLOURS
from factory.web.charts import draw_lines
from factory.web.context import context_of, svg_image
from factory.web.frames import KINDS, FrameKey, TooBusy
from factory.web.pages.find import find_episode
from schemas.terms import Recording

_MASKS = 40
"""Maximum number of frames in which the mask of the target is measured."""
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
