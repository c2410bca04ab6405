"""Encodes frames of episodes, stored or rendered on demand, in a bounded pool; keeps them in a bounded cache."""

from __future__ import annotations

import contextlib
import io
import threading
from collections import OrderedDict, defaultdict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.dataset.episode import Episode
from factory.dataset.rendering import KEPT_SCENES
from factory.visualize.panels import show_depth, show_ids
from factory.web.workspace import Workspace
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.encoding.png import encode_png
from schemas.errors import FactoryError
from schemas.terms import Recording

KINDS = ("rgb", "depth", "ids")
"""Images of a frame."""
SMALL_PX = 320
"""Width and height of the images for playback, pixels."""
# with 640 pixels, 30 frames per second of a states episode need 2.7 cores
_JPEG_QUALITY = 85
_MOST_BYTES = 64 << 20
"""Size of the cache of encoded frames, bytes."""
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
    """Whether it is an image for playback, with width and height `SMALL_PX`."""

    @property
    def media_type(self) -> str:
        """Type of the encoded image: JPEG for colour in playback, otherwise PNG."""
        return "image/jpeg" if self.is_small and self.kind == "rgb" else "image/png"


def first_frames(scenes: Sequence[str], episodes: Sequence[str]) -> list[FrameKey]:
    """Returns frame 0 of the first episode of each scene, for at most `KEPT_SCENES` scenes: no more stay prepared.

    Args:
        scenes: scene of each episode.
        episodes: ids of the episodes.
    """
    firsts = dict(zip(reversed(scenes), reversed(episodes), strict=True))
    return [FrameKey(name, 0, "rgb", is_small=False) for name in reversed(firsts.values())][:KEPT_SCENES]


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
        self._preparing = ThreadPoolExecutor(1, thread_name_prefix="prepare-frame")
        self._prepared: Future[None] | None = None
        self._lock = threading.Lock()
        self._waiting: dict[FrameKey, Future[bytes]] = {}
        self._encoded: OrderedDict[FrameKey, bytes] = OrderedDict()
        self._bytes = 0
        self._episodes: OrderedDict[str, Episode] = OrderedDict()
        self._turns: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)
        """Locks of the open episodes: frames of one episode are rendered one after another, so only one rendering
        process prepares its scene."""
        self._dataset: object = None

    def episode(self, episode_id: str) -> Episode:
        """Returns an episode; the most recently used ones stay open.

        Raises:
            KeyError: the dataset has no such episode.
        """
        dataset = self._workspace.dataset()
        with self._lock:
            if dataset is not self._dataset:  # the tables have changed; the content of an episode may differ
                self._dataset = dataset
                for kept in (self._episodes, self._turns, self._encoded):
                    kept.clear()
                self._bytes = 0
            episode = self._episodes.pop(episode_id, None) or dataset[episode_id]
            self._episodes[episode_id] = episode
            if len(self._episodes) > _KEPT_EPISODES:
                oldest, _ = self._episodes.popitem(last=False)  # the file is closed when the last reader has finished
                self._turns.pop(oldest, None)
            return episode

    def encoded(self, key: FrameKey) -> Future[bytes]:
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
            kinds = (key.kind,) if _is_stored(episode) else KINDS  # one rendering gives all three images
            made = {other: Future[bytes]() for other in (key._replace(kind=kind) for kind in kinds)}
            for future in made.values():
                future.set_running_or_notify_cancel()  # a client that disconnects does not cancel it
            self._waiting |= made
            turn = self._turns[key.episode_id]
        self._pool.submit(self._make, episode, made, turn)
        return made[key]

    @property
    def has_prepared(self) -> bool:
        return self._prepared is not None

    def prepare(self, keys: Sequence[FrameKey]) -> None:
        """Renders images in the background, one after another, so the renderer and the scenes are prepared.

        Does nothing while an earlier call runs, and for episodes that store frames. Ignores errors; a later request for
        the image reports them.
        """
        with self._lock:
            if self._prepared is None or self._prepared.done():
                self._prepared = self._preparing.submit(self._prepare, keys)

    def _prepare(self, keys: Sequence[FrameKey]) -> None:
        for key in keys:
            with contextlib.suppress(FactoryError, KeyError, IndexError, TooBusy):
                if not _is_stored(self.episode(key.episode_id)):
                    self.encoded(key).exception()  # waits for the image, so another encoding thread stays free

    def _make(self, episode: Episode, made: dict[FrameKey, Future[bytes]], turn: threading.Lock) -> None:
        images: dict[FrameKey, bytes | Exception]
        try:
            if _is_stored(episode):
                images = {key: _encode_stored(episode, key) for key in made}
            else:
                first = next(iter(made))
                with turn:
                    frame = episode.frame(first.t, SMALL_PX if first.is_small else FRAME_SIZE_PX)
                images = {key: _encode(np.asarray(getattr(frame, key.kind)), key, episode) for key in made}
        except Exception as error:  # noqa: BLE001 - raised by the futures
            images = dict.fromkeys(made, error)
        for key, future in made.items():
            self._finish(key, future, images[key])

    def _finish(self, key: FrameKey, future: Future[bytes], made: bytes | Exception) -> None:
        with self._lock:
            self._waiting.pop(key, None)
            if isinstance(made, bytes) and key.episode_id in self._episodes and key not in self._encoded:
                self._encoded[key] = made
                self._bytes += len(made)
                while self._bytes > _MOST_BYTES:
                    self._bytes -= len(self._encoded.popitem(last=False)[1])
        if isinstance(made, bytes):
            future.set_result(made)
        else:
            future.set_exception(made)


def _is_stored(episode: Episode) -> bool:
    return episode.meta.job.record is Recording.FRAMES


def _encode_stored(episode: Episode, key: FrameKey) -> bytes:
    if key.kind == "rgb" and not key.is_small:
        return episode.stored(f"rgb_front/{key.t:06d}.png")
    image, step = getattr(episode, key.kind)(key.t), FRAME_SIZE_PX // SMALL_PX if key.is_small else 1
    return _encode(image[::step, ::step], key, episode)


def _encode(image: NDArray[Any], key: FrameKey, episode: Episode) -> bytes:
    if key.kind == "depth":
        image = show_depth(image)
    elif key.kind == "ids":
        image = show_ids(image, episode.meta.target_instance_id)
    image = np.ascontiguousarray(image)
    return encode_png(image) if key.media_type == "image/png" else encode_jpeg(image)


def encode_jpeg(rgb: NDArray[np.uint8]) -> bytes:
    """Returns a colour image as JPEG."""
    held = io.BytesIO()
    Image.fromarray(rgb).save(held, "JPEG", quality=_JPEG_QUALITY)
    return held.getvalue()


def _done(data: bytes) -> Future[bytes]:
    future: Future[bytes] = Future()
    future.set_result(data)
    return future
