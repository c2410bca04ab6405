"""One archived episode, opened when something of it is wanted and decoded frame by frame. Reads only."""

from __future__ import annotations

import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import BinaryIO, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from schemas.bundle import BundleReader
from schemas.dataset import EpisodeSummary
from schemas.episode import EpisodeMeta
from schemas.errors import ArchiveCorrupt, InvalidBundle
from schemas.storage.place import Place
from schemas.support.closing import Closing

__all__ = ["Episode", "Frame"]


class Frame(NamedTuple):
    """What the robot saw before one action."""

    rgb: NDArray[np.uint8]
    """(640, 640, 3) sRGB, top row first."""
    depth: NDArray[np.float32]
    """(640, 640) metres along the optical axis; 0 where nothing was hit."""
    ids: NDArray[np.uint16]
    """(640, 640) instance ids; `Episode.meta.instances` says of what; 0 is nothing."""


class Episode(Closing):
    """An episode of T steps: T frames, T actions, T poses; frame t and pose t are from before action t.

    Cheap to make and to pickle; the file is opened at the first access and again in every process that uses it. Threads
    may share it.

    Raises:
        ArchiveCorrupt: at access, when the file is missing or damaged; the message names it.
    """

    def __init__(self, path: Place, summary: EpisodeSummary) -> None:
        self.path = path
        self.summary = summary
        """Its row of the metadata."""
        self._opened: _Opened | None = None
        self._opening = Lock()

    @property
    def episode_id(self) -> str:
        """`ep_000001` and so on."""
        return self.summary.episode_id

    @property
    def instruction(self) -> str:
        """What the robot was told."""
        return self.summary.instruction

    @property
    def meta(self) -> EpisodeMeta:
        """All that is recorded of the episode beside its arrays."""
        with self._reading() as bundle:
            return bundle.meta

    @property
    def actions(self) -> NDArray[np.float32]:
        """(T, 2) commanded twists: v in m/s, w in rad/s."""
        return self._bundle().arrays.actions_continuous

    @property
    def tokens(self) -> NDArray[np.int16]:
        """(T, 2) the actions on the 7 x 7 grid, 0..6."""
        return self._bundle().arrays.actions_tokens

    @property
    def poses(self) -> NDArray[np.float32]:
        """(T, 7) x, y, z in metres and the quaternion w, x, y, z of base_link in the world frame."""
        return self._bundle().arrays.poses

    def rgb(self, t: int) -> NDArray[np.uint8]:
        """Returns frame t as (640, 640, 3) sRGB; negative t count from the end."""
        with self._reading() as bundle:
            return bundle.rgb(self._step(t))

    def depth(self, t: int) -> NDArray[np.float32]:
        """Returns frame t as (640, 640) metres along the optical axis; negative t count from the end."""
        with self._reading() as bundle:
            return bundle.depth(self._step(t))

    def ids(self, t: int) -> NDArray[np.uint16]:
        """Returns frame t as (640, 640) instance ids; negative t count from the end."""
        with self._reading() as bundle:
            return bundle.ids(self._step(t))

    def stored(self, name: str) -> bytes:
        """Returns a member of the bundle as it is stored, e.g. `seg_front/000000.png`, without decoding it."""
        with self._reading() as bundle:
            return bundle.stored(name)

    def frame(self, t: int) -> Frame:
        """Returns frame t whole; negative t count from the end."""
        return Frame(self.rgb(t), self.depth(t), self.ids(t))

    def frames(self) -> Iterator[Frame]:
        """Yields every frame in order, one in memory at a time."""
        return (self.frame(t) for t in range(len(self)))

    def __len__(self) -> int:
        return self.summary.num_steps

    def __repr__(self) -> str:
        return f"Episode({self.episode_id}, {len(self)} steps, {self.instruction!r})"

    def _step(self, t: int) -> int:
        if not -len(self) <= t < len(self):
            raise IndexError(f"{self.episode_id} has steps 0 to {len(self) - 1}, not {t}")
        return t % len(self)

    def _bundle(self) -> BundleReader:
        with self._opening:
            if self._opened is None or self._opened.pid != os.getpid():  # a fork shares the file's position
                self._opened = _Opened(self.path, len(self))
            return self._opened.bundle

    @contextmanager
    def _reading(self) -> Iterator[BundleReader]:
        try:
            yield self._bundle()
        except InvalidBundle as error:
            raise _corrupt(self.path, error) from error

    def close(self) -> None:
        """Closes the file; a later access opens it again."""
        if self._opened is not None:
            self._opened.close()
            self._opened = None

    def __reduce__(self) -> tuple[type[Self], tuple[Place, EpisodeSummary]]:
        return type(self), (self.path, self.summary)


class _Opened:
    """A bundle, its file and the process that opened it; the file is closed when this is forgotten."""

    def __init__(self, path: Place, steps: int) -> None:
        try:
            file: BinaryIO = path.open("rb")
        except FileNotFoundError as error:
            raise ArchiveCorrupt(f"{path} is missing: run `factory verify`") from error
        except OSError as error:
            raise ArchiveCorrupt(f"{path} cannot be read: {error.strerror}") from error
        self.close = weakref.finalize(self, file.close)
        self.pid = os.getpid()
        try:
            self.bundle = BundleReader(file, steps)
        except InvalidBundle as error:
            refusal = _refusal(path, file, steps)
            self.close()
            raise refusal from error


def _refusal(path: Place, file: BinaryIO, steps: int) -> ArchiveCorrupt:
    """Says by the bundle's own metadata what is wrong with one that does not have the steps expected."""
    try:
        own = BundleReader(file)
    except InvalidBundle as error:
        return _corrupt(path, error)
    return ArchiveCorrupt(f"{path} has {own.length} steps, the metadata says {steps}: run `factory verify --deep`")


def _corrupt(path: Place, error: InvalidBundle) -> ArchiveCorrupt:
    return ArchiveCorrupt(f"{path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`")
