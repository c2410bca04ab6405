"""Open loop: recorded actions carried out blindly, the episode's own (about 1) or another one's (about 0)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coordinator.summary import file_name_of
from factory.eval.policies.outside import Outside
from factory.eval.policy import EpisodeInfo, Observation, Situation
from schemas.bundle import BundleReader
from schemas.errors import ArchiveCorrupt, InvalidBundle, UsageError
from workers.slew import Twist

__all__ = ["PlaybackPolicy", "ReplayPolicy"]


class _Recorded:
    """Carries out the actions of the episode that the situation names, then stands still."""

    def __init__(self, outside: Outside) -> None:
        if outside.root is None:
            raise UsageError("recorded actions need the dataset: give it with --data")
        self._root = outside.root

    def enter(self, situation: Situation) -> None:
        """Reads the actions."""
        if situation.recorded is None:
            raise UsageError(f"{situation.simulator.spec.spec_id} was not taken from an archived episode")
        self._actions = _actions_of(self._root / file_name_of(situation.recorded))

    def reset(self, instruction: str, info: EpisodeInfo) -> None:
        """Has nothing to forget."""

    def act(self, observation: Observation) -> Twist:
        """Returns the action that was recorded at this step."""
        step = observation["step"]
        v, w = self._actions[step] if step < len(self._actions) else (0.0, 0.0)
        return Twist(float(v), float(w))


class ReplayPolicy(_Recorded):
    """The episode's own actions: a test of determinism, whose success rate is about 1."""

    knows = "the episode's recorded actions"


class PlaybackPolicy(_Recorded):
    """Another episode's actions: what driving without looking is worth, about 0."""

    knows = "another episode's recorded actions"


def _actions_of(path: Path) -> NDArray[np.float32]:
    try:
        with path.open("rb") as file:
            return BundleReader(file).arrays.actions_continuous
    except FileNotFoundError as error:
        raise ArchiveCorrupt(f"{path} is missing: run `factory verify`") from error
    except InvalidBundle as error:
        raise ArchiveCorrupt(f"{path} is damaged ({'; '.join(error.findings)}): run `factory verify --deep`") from error
