"""Fixed vocabulary of the task: tiers, splits, categories, end reasons, and the held-out categories of each scene.

Contains tables of the paper (Tables II-IV, Sec. III) as data. Computes nothing.
"""

from __future__ import annotations

import re
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import Literal, NamedTuple


class Tier(StrEnum):
    """Distance tier of the start of an episode (paper Sec. III-D)."""

    NEAR = "near"  # 1.5-3.5 m, roughly facing the target
    MID = "mid"  # 3.5-7.0 m, roughly facing the target
    FAR = "far"  # a surveyed floor point at least 5 m away along the floor, any heading


class SuccessMeasure(StrEnum):
    """Measure of the distance from base_link to the target, for the tier of a start and the success of an episode.

    Design: docs/design/task.md#success-is-measured-to-the-footprint.
    """

    CENTROID = "centroid"  # planar distance to the target's centroid, as in the paper
    SURFACE = "surface"  # planar distance to the target's footprint, as in ObjectNav (docs/design/task.md#distances)


TIER_RANGE_M = MappingProxyType({Tier.NEAR: (1.5, 3.5), Tier.MID: (3.5, 7.0)})
"""Range of the planar distance from the start to the target by the success measure, metres, for each tier except `far`,
whose range is a distance along the floor."""
FAR_FLOOR_M = (5.0, 11.0)
"""Default range of the distance along the floor from a start in the far tier to the target, metres."""
# without the minimum, many far starts were nearer than most mid starts


class Split(StrEnum):
    """Split of the dataset that an episode belongs to (paper Sec. IV-B)."""

    TRAIN_ID = "train_id"  # seen categories, training templates
    VAL_ID = "val_id"  # as `train_id`, for validation
    TEST_ID = "test_id"  # as `train_id`, held out for testing
    TEST_PARAPHRASE_OOD = "test_paraphrase_ood"  # seen categories, paraphrased templates
    TEST_OOD_OBJ = "test_ood_obj"  # held-out categories, training templates
    # each of these differs from a split of the paper by the scene alone, so a gap between the two has one cause
    TEST_UNSEEN_SCENE = "test_unseen_scene"  # as `test_id`, in layouts of the unseen-scene splits only
    TEST_UNSEEN_SCENE_PARAPHRASE_OOD = "test_unseen_scene_paraphrase_ood"  # as `test_paraphrase_ood`, in such layouts
    TEST_UNSEEN_SCENE_OOD_OBJ = "test_unseen_scene_ood_obj"  # as `test_ood_obj`, in such layouts
    TEST_FALSE_PREMISE = "test_false_premise"  # the named object does not exist; the robot stops (docs/language.md)

    @property
    def is_unseen_scene(self) -> bool:
        """Whether the episodes are in layouts that only the splits of unseen scenes use."""
        return self.value.startswith("test_unseen_scene")

    @property
    def is_held_out(self) -> bool:
        """Whether the episodes name held-out categories."""
        return self.value.endswith("ood_obj")

    @property
    def is_paraphrased(self) -> bool:
        """Whether the instructions have paraphrased templates."""
        return self.value.endswith("paraphrase_ood")


class ExpertName(StrEnum):
    """Controller that drives; episodes of all experts have one format."""

    PROPORTIONAL = "proportional"  # the published behaviour (docs/design/experts.md#proportional-expert)
    DEPTH = "depth"  # speed from mask depth instead of centroid distance
    PAPER_LITERAL = "paper_literal"  # the equations exactly as printed; every episode ends with a timeout
    PLANNER = "planner"  # forward-only path planning and pure pursuit

    @property
    def uses_images(self) -> bool:
        """Whether the controller uses the camera image at every step."""
        return self is not ExpertName.PLANNER


class Driver(IntEnum):
    """Who acted in a step of an episode with corrections."""

    EXPERT = 0  # the planner
    POLICY = 1  # the policy that is corrected
    DISTURBANCE = 2  # random actions at the beginning


class Recording(StrEnum):
    """Content that an episode stores (docs/dataset.md#recordings).

    Design: docs/design/data.md#recordings-of-states.
    """

    FRAMES = "frames"  # actions, poses and every frame
    STATES = "states"  # actions, poses and the digests of a few frames; frames are rendered when they are read


class Screening(StrEnum):
    """Selection of the starts of experts that drive straight (docs/design/starts.md#screening)."""

    # Design: docs/design/starts.md#blind-starts-of-paper.

    NONE = "none"  # any free pose of the tier, as published: drives may fail
    SIGHT = "sight"  # as `none`, but near and mid starts have a line of sight to the target
    FREE_LINE = "free_line"  # the straight line to the success circle is free
    FORESEEN = "foreseen"  # as `free_line`, preferring a start whose predicted drive touches nothing

    @classmethod
    def _missing_(cls, value: object) -> Screening | None:
        """Accepts `free_drive` as another name of `foreseen`."""
        return cls.FORESEEN if value == "free_drive" else None


class EndReason(StrEnum):
    """Reason for the end of a rollout."""

    SUCCESS = "success"  # inside the success radius and stationary for the hold steps
    COLLISION = "collision"  # commanded forward, without progress, near an obstacle
    TIMEOUT = "timeout"  # the step limit was reached
    CONTACT = "contact"  # more steps with a contact than `demonstration.max_contact_steps`
    NOT_IN_VIEW = "not_in_view"  # success, but the last frame does not show the target, although the plan requires it


class FailReason(StrEnum):
    """Reason why an attempt produced no episode; those of the task count against the attempt budget."""

    SPAWN = "spawn"  # no valid start pose was found
    COLLISION = "collision"  # the expert stalled at an obstacle
    TIMEOUT = "timeout"  # the expert did not arrive within the step limit
    NO_PATH = "no_path"  # the planner found no drivable path
    CONTACT = "contact"  # the robot touched something in more steps than the plan allows
    NOT_IN_VIEW = "not_in_view"  # the last frame does not show the target, although the plan requires it
    NO_VIEW = "no_view"  # the start view is one flat surface, or an expert that uses images never saw the target
    POLICY = "policy"  # the policy that is corrected raised, hung, or gave no valid action
    LAYOUT = "layout"  # the seed of a layout gives no valid layout, or one that cannot fulfil the plan
    INVALID = "invalid"  # validation rejected the bundle
    CRASH = "crash"  # the simulation process crashed
    HANG = "hang"  # the simulation process made no progress
    RELEASED = "released"  # the worker returned the job without a failure, e.g. at a drain

    @property
    def is_task_failure(self) -> bool:
        """Whether seed and scene caused the failure, so a repetition of the attempt would fail again."""
        return self not in {FailReason.INVALID, FailReason.CRASH, FailReason.HANG, FailReason.RELEASED}

    @property
    def is_worker_failure(self) -> bool:
        """Whether the failure counts towards the quarantine of the job, not against the attempt budget."""
        return self in {FailReason.CRASH, FailReason.HANG, FailReason.INVALID}


RendererKind = Literal["auto", "gl", "tiny"]
"""`gl` is OpenGL through EGL, `tiny` is PyBullet's TinyRenderer, `auto` is the first of them that works."""

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
"""Twelve object categories of the paper."""

COLOUR_NAMES = ("black", "gray", "white", "red", "orange", "yellow", "green", "blue", "purple", "pink", "brown")
"""Eleven basic colour terms; a target without a dominant colour is `unknown`."""


class SceneCategories(NamedTuple):
    """Seen and held-out categories of a scene (paper Table II)."""

    seen: tuple[str, ...]
    """Categories of the in-distribution splits."""
    held_out: tuple[str, ...]
    """Categories of the split `test_ood_obj` only."""


_WAREHOUSE = SceneCategories(("shelf", "rack"), ("barrel", "crate"))
_HELD_OUT_INDOORS = ("fire_extinguisher", "whiteboard")
BUILTIN_CATEGORIES = MappingProxyType(
    {
        "office": SceneCategories(("chair", "sofa", "table", "monitor", "plant", "trash_can"), _HELD_OUT_INDOORS),
        "hospital": SceneCategories(("chair", "trash_can"), _HELD_OUT_INDOORS),
        "full_warehouse": _WAREHOUSE,
        "warehouse_multiple_shelves": _WAREHOUSE,
        "home": SceneCategories(
            (
                "chair",
                "sofa",
                "table",
                "bed",
                "wardrobe",
                "dresser",
                "nightstand",
                "cabinet",
                "shelf",
                "plant",
                "lamp",
                "television",
                "refrigerator",
                "oven",
                "sink",
                "toilet",
                "basket",
                "picture",
                "trash_can",
                "ottoman",
                "mirror",
            ),
            ("bathtub", "washing_machine", "dishwasher", "vase", "microwave", "suitcase"),
        ),
        "shop": SceneCategories(
            (
                "shelf",
                "counter",
                "refrigerator",
                "clothes_rack",
                "cart",
                "chair",
                "table",
                "cabinet",
                "plant",
                "trash_can",
                "box",
                "toilet",
                "sink",
                "crate",
            ),
            ("mannequin", "vending_machine", "ladder", "basket"),
        ),
        "school": SceneCategories(
            (
                "chair",
                "table",
                "whiteboard",
                "shelf",
                "cabinet",
                "trash_can",
                "plant",
                "backpack",
                "laptop",
                "bench",
                "printer",
                "sofa",
                "toilet",
                "sink",
                "clock",
                "monitor",
                "lamp",
            ),
            ("piano", "bicycle", "vending_machine", "water_cooler", "computer", "traffic_cone", "fire_extinguisher"),
        ),
    }
)
"""Categories of the built-in scenes by scene name: the scenes of the paper (Table II), and the families of layouts."""
_LAYOUT = re.compile(rf"({'|'.join(BUILTIN_CATEGORIES)})_([0-9]{{5,9}})", re.ASCII)


def layout_name(family: str, seed: int) -> str:
    """Returns the name of a layout, such as `home_00017`, from its family and its first seed."""
    return f"{family}_{seed:05d}"


def layout_number(scene: str) -> int | None:
    """Returns the number in the name of a layout, or `None` if the name is not that of a layout."""
    match = _LAYOUT.fullmatch(scene)
    return None if match is None else int(match[2])


def family_of(scene: str) -> str:
    """Returns the family of a layout, such as `home` for `home_00017`; for any other scene, its name."""
    match = _LAYOUT.fullmatch(scene)
    return scene if match is None else match[1]


PAPER_SCENES = ("office", "hospital", "full_warehouse", "warehouse_multiple_shelves")
"""Scenes of the paper. Their targets are of the paper's categories only."""
