"""Policies as users write them, good and bad; driving processes import them by name."""

from __future__ import annotations

import importlib
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

__all__ = [
    "Compiles",
    "Dies",
    "Guards",
    "Hangs",
    "Listens",
    "NoMethods",
    "Raises",
    "RefusesToBeMade",
    "Tokens",
    "Truant",
]


class _Quiet:
    def reset(self, instruction: str, info: Any) -> None:
        self.instruction, self.info = instruction, info


class Raises(_Quiet):
    """Drives three steps and trips."""

    def act(self, observation: dict[str, Any]) -> Any:
        if observation["step"] == 3:
            raise KeyError("depth_front")
        return 0.5, 0.0


class Hangs(_Quiet):
    """Drives five steps and falls asleep."""

    def act(self, observation: dict[str, Any]) -> Any:
        if observation["step"] == 5:
            time.sleep(600)
        return 0.5, 0.0


class Dawdles(_Quiet):
    """Stands still and takes its time over it: three seconds for 60 steps."""

    def act(self, observation: dict[str, Any]) -> Any:
        time.sleep(0.05)
        return 0.0, 0.0


class Dies(_Quiet):
    """Takes its process along."""

    def act(self, observation: dict[str, Any]) -> Any:
        os._exit(7)


class Truant(_Quiet):
    """Answers with what is no action, another one in each episode."""

    answers = iter((np.full(2, np.nan), np.zeros(3), "left"))

    def act(self, observation: dict[str, Any]) -> Any:
        return next(self.answers)


class Tokens(_Quiet):
    """Turns on the spot, in tokens and in chunks."""

    actions = "tokens"

    def act(self, observation: dict[str, Any]) -> Any:
        return np.array([[0, 6]] * 10)


class Listens(_Quiet):
    """Checks what it is given, stands still, and turns when it is told nothing."""

    def act(self, observation: dict[str, Any]) -> Any:
        assert set(observation) == {"rgb", "depth", "instruction", "step"}, sorted(observation)
        assert observation["rgb"].shape == (640, 640, 3)
        assert observation["depth"].shape == (640, 640)
        assert observation["instruction"] == self.instruction
        assert not hasattr(self, "situation")
        print("a policy may print")  # noqa: T201 - and must not disturb the reports
        return (0.0, 0.0) if self.instruction else (0.0, 1.0)

    def enter(self, situation: Any) -> None:
        """Tries to be let in, as the built-in experts are."""
        self.situation = situation


class NoMethods:
    """Is no policy."""


class RefusesToBeMade(_Quiet):
    """Cannot be made."""

    def __init__(self) -> None:
        raise FileNotFoundError("weights.pt")


class Guards(_Quiet):
    """Stands still where its process has loaded no graphics driver, and trips otherwise."""

    def act(self, observation: dict[str, Any]) -> Any:
        mapped = Path("/proc/self/maps").read_text()
        found = [name for name in ("libEGL", "libLLVM", "_dri.so", "libgallium") if name in mapped]
        assert not found, found
        assert observation["rgb"].any()
        return 0.0, 0.0


class Compiles(_Quiet):
    """Loads PyTorch's compiler and Triton, with the LLVM that they bring, in the middle of an episode."""

    def act(self, observation: dict[str, Any]) -> Any:
        if observation["step"] == 2:
            importlib.import_module("torch._dynamo")
            importlib.import_module("triton")
        return 0.0, 0.0
