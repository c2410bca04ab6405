"""Page of two episodes side by side on one time axis: colour, map, instruction, measures and plots of both."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from factory.dataset.episode import Episode
from factory.web.context import context_of, page
from factory.web.frames import FrameKey
from factory.web.pages.episode import facts_of, plots_of, similar_episodes, step_in, track_of
from factory.web.pages.find import find_episode
from schemas.errors import UsageError
from schemas.terms import Recording

_PLOTS = 3
"""Number of plots of each episode: speed, turn rate and distance."""
_FACTS = 11
"""Number of facts of each episode; the others name worker, recording and files."""


def routes() -> list[Route]:
    return [Route("/pair", show)]


def show(request: Request) -> Response:
    """Answers with the page: `?first=ID&second=ID`, and `&t=STEP` for browsers without JavaScript.

    A step is one of the episode with the higher rate; the other one shows its frame of the same time.
    """
    context, query = context_of(request), request.query_params
    names = [query.get("first", "").strip(), query.get("second", "").strip()]
    if not all(names):
        raise UsageError("the page needs two episodes: /pair?first=ep_000001&second=ep_000002")
    episodes = [find_episode(context, name) for name in names]
    hz = max(_hz(episode) for episode in episodes)
    end_s = max((len(episode) - 1) / _hz(episode) for episode in episodes)
    last = round(end_s * hz)
    t = min(step_in(request), last)
    steps = [min(len(episode) - 1, round(t * _hz(episode) / hz)) for episode in episodes]
    context.frames.prepare(
        [FrameKey(name, step, "rgb", is_small=False) for name, step in zip(names, steps, strict=True)]
    )
    facts = [facts_of(episode)[:_FACTS] for episode in episodes]
    return page(
        request,
        "pair",
        " and ".join(names),
        names=names,
        sides=[
            (episode.summary, _hz(episode), step, track_of(episode, step), plots[:_PLOTS])
            for episode, step, plots in zip(episodes, steps, plots_of(episodes, end_s), strict=True)
        ],
        rendered=[episode.meta.job.record is not Recording.FRAMES for episode in episodes],
        facts=[(name, one, other) for (name, one), (_, other) in zip(*facts, strict=True)],
        choices=similar_episodes(context, episodes[0]),
        t=t,
        last=last,
        hz=hz,
    )


def _hz(episode: Episode) -> int:
    return episode.meta.job.task.control_hz
