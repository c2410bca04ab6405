"""Finds the episode of a request, or names the nearest one."""

from __future__ import annotations

import numpy as np
from starlette.exceptions import HTTPException

from factory.dataset.episode import Episode
from factory.web.context import WebContext
from schemas.job import index_of_file


class NoEpisode(HTTPException):
    """The dataset has no such episode. `nearest` is the id of the nearest one; empty if there is none."""

    def __init__(self, episode_id: str, nearest: str) -> None:
        near = f"; the nearest one is {nearest}" if nearest else ""
        super().__init__(404, f"the dataset has no episode {episode_id[:80]!r}{near}")
        self.nearest = nearest


def find_episode(context: WebContext, episode_id: str) -> Episode:
    """Returns an episode of the dataset.

    Raises:
        NoEpisode: the dataset has no such episode.
    """
    try:
        return context.frames.episode(episode_id)
    except KeyError as error:
        raise NoEpisode(episode_id, _nearest(context, episode_id)) from error


def _nearest(context: WebContext, episode_id: str) -> str:
    dataset = context.workspace.dataset()
    wanted = index_of_file(f"{episode_id}.zip")
    digits = "".join(filter(str.isdigit, episode_id[:40]))
    number = wanted or int(digits or 0)
    indices = dataset.column("index").to_numpy(zero_copy_only=False)
    return str(dataset.column("episode_id")[int(np.abs(indices - number).argmin())]) if len(indices) else ""
