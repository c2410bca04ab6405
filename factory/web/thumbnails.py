"""Makes small pictures of episodes, one after another, and keeps them in a bounded cache. Writes no files."""

from __future__ import annotations

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from factory.dataset.episode import Episode
from factory.web.frames import TooBusy, encode_jpeg
from schemas.dataset.meta import DatasetMeta
from schemas.terms import Recording

THUMBNAIL_PX = 320
"""Width and height of a thumbnail, pixels."""
_MOST_BYTES = 32 << 20
"""Size of the cache, bytes; a thumbnail has 10 to 25 kB."""
_MOST_WAITING = 400


class ThumbnailKey(NamedTuple):
    """Content of an episode."""

    episode_id: str
    digest: str
    """Digest of the bundle, so an episode that was written again has a new thumbnail."""


class ThumbnailStore:
    """Thread-safe source of thumbnails: the first colour frames of episodes as JPEG, `THUMBNAIL_PX` square.

    Args:
        most_bytes: size of the cache, bytes.
    """

    def __init__(self, most_bytes: int = _MOST_BYTES) -> None:
        self._most_bytes = most_bytes
        # one thread, so a page with many thumbnails leaves a rendering process to an episode that plays
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="thumbnail")
        self._lock = threading.Lock()
        self._waiting: dict[ThumbnailKey, Future[bytes]] = {}
        self._made: OrderedDict[ThumbnailKey, bytes] = OrderedDict()
        self._bytes = 0

    def encoded(self, episode: Episode) -> Future[bytes]:
        """Returns the future of the thumbnail of an episode; equal requests share one rendering.

        Raises:
            TooBusy: too many thumbnails are waiting.
        """
        key = ThumbnailKey(episode.episode_id, episode.summary.content_digest)
        with self._lock:
            if key in self._waiting:
                return self._waiting[key]
            future = Future[bytes]()
            future.set_running_or_notify_cancel()  # a client that disconnects does not cancel it
            if key in self._made:
                self._made.move_to_end(key)
                future.set_result(self._made[key])
                return future
            if len(self._waiting) >= _MOST_WAITING:
                raise TooBusy(f"{_MOST_WAITING} thumbnails are waiting")
            self._waiting[key] = future
        self._pool.submit(self._make, key, episode, future)
        return future

    def _make(self, key: ThumbnailKey, episode: Episode, future: Future[bytes]) -> None:
        try:
            with episode:
                data = encode_jpeg(draw_thumbnail(episode))
        except Exception as error:  # noqa: BLE001 - raised by the future
            with self._lock:
                self._waiting.pop(key)
            future.set_exception(error)
            return
        with self._lock:
            self._waiting.pop(key)
            self._made[key] = data
            self._bytes += len(data)
            while self._bytes > self._most_bytes and len(self._made) > 1:
                self._bytes -= len(self._made.popitem(last=False)[1])
        future.set_result(data)


def draw_thumbnail(episode: Episode) -> NDArray[np.uint8]:
    """Returns the first frame of an episode, (`THUMBNAIL_PX`, `THUMBNAIL_PX`, 3) sRGB."""
    if episode.meta.job.record is not Recording.FRAMES:
        return np.asarray(episode.frame(0, THUMBNAIL_PX).rgb)
    whole = episode.rgb(0)
    return np.asarray(Image.fromarray(whole).reduce(len(whole) // THUMBNAIL_PX))


def dataset_version(meta: DatasetMeta | None) -> str:
    """Returns a text that differs between datasets: their servers may have the same address one after another."""
    return f"{meta.plan_digest} {meta.created_at}" if meta else ""


def thumbnail_urls(rows: Iterable[Mapping[str, Any]], base: str, version: str) -> list[str]:
    """Returns the URL of the thumbnail of each row. It changes with the row, so browsers may keep its content.

    Args:
        rows: rows of the table of episodes.
        base: prefix of the paths of the dataset's pages.
        version: result of `dataset_version`.
    """
    return [
        f"{base}/episodes/{row['episode_id']}/thumbnail.jpg?of={short_digest(f'{version} {sorted(row.items())}')}"
        for row in rows
    ]


def short_digest(text: str) -> str:
    """Returns 12 hexadecimal digits that change with a text, for the query of a URL whose content browsers keep."""
    return hashlib.sha256(text.encode()).hexdigest()[:12]
