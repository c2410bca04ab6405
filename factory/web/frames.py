"""Encodes frames of episodes as PNG: stored or rendered on demand, in a bounded pool, kept in a bounded cache."""

from __future__ import annotations

import threading
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from factory.dataset.episode import Episode, Frame
from factory.visualize.panels import show_depth, show_ids
from factory.web.workspace import Workspace
from schemas.encoding.png import encode_png
from schemas.terms import Recording

KINDS = ("rgb", "depth", "ids")
"""Images of a frame."""
_MOST_BYTES = 64 << 20
"""Size of the cache of encoded frames, bytes."""
_KEPT_FRAMES = 8
"""Number of rendered frames whose three images are kept for encoding."""
_KEPT_EPISODES = 16
_THREADS = 2
_MOST_WAITING = 200


class FrameKey(NamedTuple):
    """Image of a frame."""

    episode_id: str
    t: int
    kind: str
    """`rgb`, `depth` or `ids`."""
    is_small: bool
    """Whether every second row and column is omitted."""


class TooBusy(Exception):
    """Too many frames wait to be encoded."""


class FrameStore:
    """Thread-safe source of encoded frames.

    Args:
        workspace: the dataset.
    """

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="frame")
        self._lock = threading.Lock()
        self._waiting: dict[FrameKey, Future[bytes]] = {}
        self._encoded: OrderedDict[FrameKey, bytes] = OrderedDict()
        self._bytes = 0
        self._episodes: OrderedDict[str, Episode] = OrderedDict()
        self._rendered: OrderedDict[tuple[str, int], Future[Frame]] = OrderedDict()
        self._dataset: object = None

    def episode(self, episode_id: str) -> Episode:
        """Returns an episode; the most recently used ones stay open.

        Raises:
            KeyError: the dataset has no such episode.
        """
        dataset = self._workspace.dataset()
        with self._lock:
            if dataset is not self._dataset:  # the tables have changed; an episode may have another content
                self._dataset = dataset
                for kept in (self._episodes, self._encoded, self._rendered):
                    kept.clear()
                self._bytes = 0
            episode = self._episodes.pop(episode_id, None) or dataset[episode_id]
            self._episodes[episode_id] = episode
            if len(self._episodes) > _KEPT_EPISODES:
                self._episodes.popitem(last=False)  # the file is closed when the last reader has finished
            return episode

    def png(self, key: FrameKey) -> Future[bytes]:
        """Returns the future of an image; equal requests share one encoding.

        Raises:
            KeyError: the dataset has no such episode.
            IndexError: the episode has no such step.
            TooBusy: too many images are waiting.
        """
        episode = self.episode(key.episode_id)
        if not 0 <= key.t < len(episode):
            raise IndexError(f"{key.episode_id} has steps 0 to {len(episode) - 1}, not {key.t}")
        with self._lock:
            if key in self._encoded:
                self._encoded.move_to_end(key)
                return _done(self._encoded[key])
            if key in self._waiting:
                return self._waiting[key]
            if len(self._waiting) >= _MOST_WAITING:
                raise TooBusy(f"{_MOST_WAITING} frames are waiting")
            future = self._waiting[key] = self._pool.submit(self._encode, episode, key)
        future.add_done_callback(lambda made: self._keep(key, made))
        return future

    def _encode(self, episode: Episode, key: FrameKey) -> bytes:
        step = 2 if key.is_small else 1
        if episode.meta.job.record is not Recording.FRAMES:
            image = np.asarray(getattr(self._frame(episode, key.t), key.kind))
        elif key.kind == "rgb" and step == 1:
            return episode.stored(f"rgb_front/{key.t:06d}.png")
        else:
            image = getattr(episode, key.kind)(key.t)
        image = image[::step, ::step]
        if key.kind == "depth":
            image = show_depth(image)
        elif key.kind == "ids":
            image = show_ids(image, episode.meta.target_instance_id)
        return encode_png(np.ascontiguousarray(image))

    def _frame(self, episode: Episode, t: int) -> Frame:
        """Returns a rendered frame; the three images of a frame are rendered together, once."""
        key = (episode.episode_id, t)
        with self._lock:
            future = self._rendered.get(key)
            is_mine = future is None
            if future is None:
                future = self._rendered[key] = Future()
                while len(self._rendered) > _KEPT_FRAMES:
                    self._rendered.popitem(last=False)
        if is_mine:
            try:
                future.set_result(episode.frame(t))
            except Exception as error:  # noqa: BLE001 - raised by the future
                future.set_exception(error)
                with self._lock:
                    self._rendered.pop(key, None)
        return future.result()

    def _keep(self, key: FrameKey, made: Future[bytes]) -> None:
        with self._lock:
            self._waiting.pop(key, None)
            if made.exception() is not None or key.episode_id not in self._episodes:
                return
            self._encoded[key] = made.result()
            self._bytes += len(made.result())
            while self._bytes > _MOST_BYTES:
                self._bytes -= len(self._encoded.popitem(last=False)[1])


def _done(data: bytes) -> Future[bytes]:
    future: Future[bytes] = Future()
    future.set_result(data)
    return future
