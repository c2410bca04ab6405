"""Parses the output of a policy into twists; checks shape, type and range. Pure functions; simulates nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from factory.eval.driving.policy import PolicyFailure, PolicyFault
from schemas.tokens import GRID_POINTS, actions_of
from workers.geometry.slew import Twist

ACTION_KINDS = ("continuous", "tokens")
MAX_CHUNK = 1000
"""Maximum number of actions in one policy output."""


class ActionChunk(NamedTuple):
    """Actions of one policy output, in order."""

    twists: tuple[Twist, ...]
    """Requested twists; the simulator clips them to the range of the robot."""
    beyond: int
    """Number of actions outside of the range."""


def read_actions(answer: Any, kind: str, max_v_mps: float, max_w_rps: float) -> ActionChunk:
    """Returns the twists of a policy output.

    Args:
        answer: (2,) or (H, 2) numbers, or a mapping with one of the keys `actions` (v, w) and `tokens`.
        kind: `continuous` or `tokens`, for outputs that are not a mapping.
        max_v_mps: Maximum speed; the range is 0 to this value.
        max_w_rps: Maximum yaw rate; the range is plus or minus this value.

    Raises:
        PolicyFailure: The output is not a valid action; the message names the expected and the actual value.
    """
    if isinstance(answer, Mapping):
        answer, kind = _unwrap(answer)
    if kind not in ACTION_KINDS:
        raise _invalid(f"{kind[:40]!r} is not a valid action kind; valid kinds: {', '.join(ACTION_KINDS)}")
    numbers = _numbers(answer)
    if kind == "tokens":
        numbers = actions_of(_tokens(numbers)).astype(np.float64)
    low, high = np.array((0.0, -max_w_rps)), np.array((max_v_mps, max_w_rps))
    beyond = int(((numbers < low) | (numbers > high)).any(axis=1).sum())
    return ActionChunk(tuple(Twist(float(v), float(w)) for v, w in numbers), beyond)


def _unwrap(answer: Mapping[Any, Any]) -> tuple[Any, str]:
    for key, kind in (("actions", "continuous"), ("tokens", "tokens")):
        if key in answer:
            return answer[key], kind
    raise _invalid(f"expected a key 'actions' or 'tokens', found {sorted(map(str, answer))[:8]}")


def _numbers(answer: Any) -> NDArray[np.float64]:
    try:
        numbers = np.asarray(answer, np.float64)
    except (TypeError, ValueError) as error:
        raise _invalid(f"expected two numbers, found a {type(answer).__name__} that is not numeric: {error}") from error
    if numbers.shape == (2,):
        numbers = numbers[None]
    if numbers.ndim != 2 or numbers.shape[1] != 2 or not 1 <= len(numbers) <= MAX_CHUNK:
        raise _invalid(f"expected the shape (2,) or (H, 2) with H up to {MAX_CHUNK}, found {np.shape(answer)}")
    if not np.isfinite(numbers).all():
        raise _invalid(f"expected finite numbers, found {numbers[~np.isfinite(numbers).all(axis=1)][0].tolist()}")
    return numbers


def _tokens(numbers: NDArray[np.float64]) -> NDArray[np.int16]:
    if not np.isin(numbers, np.arange(GRID_POINTS)).all():
        raise _invalid(f"expected tokens 0 to {GRID_POINTS - 1}, found {numbers.tolist()[:3]}")
    return numbers.astype(np.int16)


def _invalid(detail: str) -> PolicyFailure:
    return PolicyFailure(PolicyFault.INVALID, detail)
