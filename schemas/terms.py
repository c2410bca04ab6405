"""The fixed vocabulary of the task: tiers, splits, categories, end reasons and who holds out what.

Holds tables of the paper (Tables II-IV, Sec. III) as data; it never computes with them.
"""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType
from typing import Literal, NamedTuple

__all__ = [
    "BUILTIN_CATEGORIES",
    "CATEGORIES",
    "COLOUR_NAMES",
    "TIER_RANGE_M",
    "EndReason",
    "ExpertName",
    "FailReason",
    "RendererKind",
    "SceneCategories",
    "Split",
    "Tier",
]


class Tier(StrEnum):
    """How far from its target an episode starts (paper Sec. III-D)."""

    NEAR = "near"  # 1.5-3.5 m, roughly facing the target
    MID = "mid"  # 3.5-7.0 m, roughly facing the target
    FAR = "far"  # a surveyed floor point anywhere in the scene, any heading


TIER_RANGE_M = MappingProxyType({Tier.NEAR: (1.5, 3.5), Tier.MID: (3.5, 7.0)})
"""Spawn distance ranges in metres, planar, from the target's centroid; `far` has none."""


class Split(StrEnum):
    """Which evaluation question an episode serves (paper Sec. IV-B)."""

    TRAIN_ID = "train_id"  # seen categories, training templates
    VAL_ID = "val_id"  # the same, for validation
    TEST_ID = "test_id"  # the same, held out for testing
    TEST_PARAPHRASE_OOD = "test_paraphrase_ood"  # seen categories, paraphrased templates
    TEST_OOD_OBJ = "test_ood_obj"  # held-out categories, training templates


class ExpertName(StrEnum):
    """Which controller drives; every expert writes the same kind of episode."""

    PROPORTIONAL = "proportional"  # the published behaviour (docs/design/experts.md#proportional-expert)
    DEPTH = "depth"  # speed from mask depth instead of centroid distance
    PAPER_LITERAL = "paper_literal"  # the equations exactly as printed; only ever times out
    PLANNER = "planner"  # forward-only path planning and pure pursuit


class EndReason(StrEnum):
    """Why a rollout ended."""

    SUCCESS = "success"  # inside the radius and stationary for the hold steps
    COLLISION = "collision"  # commanded forward, no progress, near an obstacle
    TIMEOUT = "timeout"  # the step limit was reached


class FailReason(StrEnum):
    """Why an attempt brought no episode; the first four count against the attempt budget."""

    SPAWN = "spawn"  # no valid start pose was found
    COLLISION = "collision"  # the expert stalled against something
    TIMEOUT = "timeout"  # the expert did not arrive within the step limit
    NO_PATH = "no_path"  # the planner found no drivable path
    INVALID = "invalid"  # the coordinator's validation refused the bundle
    CRASH = "crash"  # the simulation process died
    HANG = "hang"  # the simulation process made no progress
    RELEASED = "released"  # the worker gave the job back unharmed (drain)

    @property
    def is_task_failure(self) -> bool:
        """Whether the attempt failed by its own seed and world, so that repeating it would fail again."""
        return self in {FailReason.SPAWN, FailReason.COLLISION, FailReason.TIMEOUT, FailReason.NO_PATH}

    @property
    def is_of_the_worker(self) -> bool:
        """Whether a worker suffered: such failures count towards quarantine, not towards the budget."""
        return self in {FailReason.CRASH, FailReason.HANG, FailReason.INVALID}


RendererKind = Literal["auto", "gl", "tiny"]
"""`gl` is OpenGL through EGL, `tiny` PyBullet's TinyRenderer, `auto` the first of them that works."""

CATEGORIES = (
    "chair",
    "sofa",
    "table",
    "monitor",
    "plant",
    "trash_can",
    "fire_extinguisher",
    "whiteboard",
    "shelf",
    "rack",
    "barrel",
    "crate",
)
"""The paper's twelve object categories."""

COLOUR_NAMES = ("black", "gray", "white", "red", "orange", "yellow", "green", "blue", "purple", "pink", "brown")
"""The eleven basic colour terms; a target of no one colour is `unknown`."""


class SceneCategories(NamedTuple):
    """Which categories a scene trains on and which it holds out (paper Table II)."""

    seen: tuple[str, ...]
    held_out: tuple[str, ...]


_WAREHOUSE = SceneCategories(("shelf", "rack"), ("barrel", "crate"))
_HELD_OUT_INDOORS = ("fire_extinguisher", "whiteboard")
BUILTIN_CATEGORIES = MappingProxyType(
    {
        "office": SceneCategories(("chair", "sofa", "table", "monitor", "plant", "trash_can"), _HELD_OUT_INDOORS),
        "hospital": SceneCategories(("chair", "trash_can"), _HELD_OUT_INDOORS),
        "full_warehouse": _WAREHOUSE,
        "warehouse_multiple_shelves": _WAREHOUSE,
    }
)
"""Paper Table II, by scene name."""
