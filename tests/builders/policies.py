"""Correct and faulty policies in the form of user code; processes import them by name."""

from __future__ import annotations

import importlib
import os
import time
from pathlib import Path
from typing import Any

import numpy as np


class _Quiet:
    def reset(self, instruction: str, info: Any) -> None:
        self.instruction, self.info = instruction, info


class Raises(_Quiet):
    """Raises an exception after three steps."""

    def act(self, observation: dict[str, Any]) -> Any:
        if observation["step"] == 3:
            raise KeyError("depth_front")
        return 0.5, 0.0


class Scans(_Quiet):
    """Does not move; requests a lidar of the rig, and checks that its input has the ranges but no recorded images."""

    needs = ("scan/ranges",)

    def act(self, observation: dict[str, Any]) -> Any:
        assert observation["sensors"]["scan"]["ranges"].shape == (1, 90)
        assert not observation.keys() & {"rgb", "depth"}
        return 0.0, 0.0


class Looks(_Quiet):
    """Does not move; needs the recorded camera."""

    needs = ("rgb", "depth")

    def act(self, observation: dict[str, Any]) -> Any:
        assert observation["rgb"].shape == (640, 640, 3)
        return 0.0, 0.0


class Hangs(_Quiet):
    """Blocks after five steps."""

    def act(self, observation: dict[str, Any]) -> Any:
        if observation["step"] == 5:
            time.sleep(600)
        return 0.5, 0.0


class Slow(_Quiet):
    """Does not move and takes three seconds for 20 steps."""

    def act(self, observation: dict[str, Any]) -> Any:
        time.sleep(0.15)
        return 0.0, 0.0


class TellsSteps(_Quiet):
    """Drives, and raises an exception with the steps of its first four observations."""

    def reset(self, instruction: str, info: Any) -> None:
        self.steps: list[int] = []

    def act(self, observation: dict[str, Any]) -> Any:
        self.steps.append(observation["step"])
        if len(self.steps) == 4:
            raise ValueError(self.steps)
        return [(0.5, 0.0)] * 2


class ThinksAndTellsSteps(TellsSteps):
    """As its base class, and thinks for 0.2 s."""

    def act(self, observation: dict[str, Any]) -> Any:
        time.sleep(0.2)
        return super().act(observation)


class LoadsSlowly(_Quiet):
    """Does not move; its first answer takes three seconds."""

    def act(self, observation: dict[str, Any]) -> Any:
        if observation["step"] == 0:
            time.sleep(3.0)
        return 0.0, 0.0


class Dies(_Quiet):
    """Ends its process."""

    def act(self, observation: dict[str, Any]) -> Any:
        os._exit(7)


class InvalidAnswers(_Quiet):
    """Returns an invalid action, a different kind in each episode."""

    answers = iter((np.full(2, np.nan), np.zeros(3), "left"))

    def act(self, observation: dict[str, Any]) -> Any:
        return next(self.answers)


class Tokens(_Quiet):
    """Turns on the spot; its actions are chunks of tokens."""

    actions = "tokens"

    def act(self, observation: dict[str, Any]) -> Any:
        return np.array([[0, 6]] * 10)


class ChecksInput(_Quiet):
    """Checks its input, does not move, and turns if the instruction is empty."""

    def act(self, observation: dict[str, Any]) -> Any:
        assert set(observation) == {"rgb", "depth", "state", "instruction", "step"}, sorted(observation)
        assert (observation["state"].shape, observation["state"].dtype) == ((5,), np.float32)
        assert observation["rgb"].shape == (640, 640, 3)
        assert observation["depth"].shape == (640, 640)
        assert observation["instruction"] == self.instruction
        assert not hasattr(self, "state")
        print("a policy may print")  # noqa: T201 - output must not disturb the reports
        return (0.0, 0.0) if self.instruction else (0.0, 1.0)

    def enter(self, state: Any) -> None:
        """Tries to get the privileged input of built-in experts."""
        self.state = state


class NoMethods:
    """Not a policy."""


class CannotBeConstructed(_Quiet):
    """Raises an exception in its constructor."""

    def __init__(self) -> None:
        raise FileNotFoundError("weights.pt")


class ChecksDriver(_Quiet):
    """Does not move; raises an exception if its process has loaded a graphics driver."""

    def act(self, observation: dict[str, Any]) -> Any:
        mapped = Path("/proc/self/maps").read_text()
        found = [name for name in ("libEGL", "libLLVM", "_dri.so", "libgallium") if name in mapped]
        assert not found, found
        assert observation["rgb"].any()
        return 0.0, 0.0


class Compiles(_Quiet):
    """Loads PyTorch's compiler and Triton with their LLVM during an episode."""

    def act(self, observation: dict[str, Any]) -> Any:
        if observation["step"] == 2:
            importlib.import_module("torch._dynamo")
            importlib.import_module("triton")
        return 0.0, 0.0


class Forgets(_Quiet):
    """Turns in the direction of its number of calls in all episodes, because `reset` does not restore its state."""

    needs = ()

    def __init__(self) -> None:
        self.calls = 0

    def act(self, observation: dict[str, Any]) -> Any:
        self.calls += 1
        return 0.3, 1.0 if self.calls > 12 else -1.0


class Resets(Forgets):
    """Restores its state in `reset`."""

    def reset(self, instruction: str, info: Any) -> None:
        super().reset(instruction, info)
        self.calls = 0
