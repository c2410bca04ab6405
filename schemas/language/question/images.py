"""Compares a question with the recorded instance ids and depth of its frame. Reads no text."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from schemas.config import CameraConfig
from schemas.instruction.seen_objects import SeenObject, see_objects
from schemas.language import thresholds as limit
from schemas.language.graph.scene_graph import SceneGraph
from schemas.language.question.model import AnswerKind, QuestionMeaning, ReasonKind, SeenSide
from schemas.language.route.thresholds import METRES

_CLEAR_PX, _HIDDEN_PX = 60, 12
"""`_CLEAR_PX`: minimum number of pixels of an object that an answer calls visible. `_HIDDEN_PX`: maximum number of
pixels of the objects that an answer calls not visible. Images have 640 x 640 pixels."""
_SIDE_RAD = math.radians(8)
"""Tolerance of the direction to an object, radians. The middle of its mask moves if other objects hide a part of it."""
_METRES_FREE = 0.4
"""Absolute part of the tolerance of distances, metres: the nearest visible point of an object may be above the middle
of its footprint instead of at the edge."""


class FrameImages(Protocol):
    """Source of the recorded images of an episode, such as `Episode` or `BundleReader`."""

    def ids(self, t: int) -> NDArray[np.uint16]:
        """Returns the (640, 640) instance ids at frame t."""

    def depth(self, t: int) -> NDArray[np.float32]:
        """Returns the (640, 640) depth at frame t, metres."""


def image_fault(
    meaning: QuestionMeaning,
    fitting: Collection[int],
    images: FrameImages,
    t: int,
    graph: SceneGraph,
    camera: CameraConfig,
) -> str:
    """Returns why the images of a frame contradict an answer about what is visible; empty if they do not.

    Args:
        meaning: meaning of question, answer and reason.
        fitting: numbers of the objects that question or answer name, or may name.
        images: images of the episode.
        t: frame.
        graph: scene graph.
        camera: camera of the images.
    """
    ids = images.ids(t)
    parts = [part for number in fitting for part in graph.objects[number].ids]
    is_shown = meaning.answer in (AnswerKind.YES, AnswerKind.THERE, AnswerKind.OBJECT)
    if not is_shown:
        if meaning.reason in (ReasonKind.NONE_EXISTS, ReasonKind.NOT_IN_VIEW) or meaning.answer is AnswerKind.UNSEEN:
            return "the image shows such an object" if np.isin(ids, parts).sum() > _HIDDEN_PX else ""
        return ""
    seen = see_objects(ids, images.depth(t), parts, camera, _CLEAR_PX)
    if not any(_is_at(each, meaning) for each in seen):
        return "the image shows no such object at this side and distance" if seen else "the image shows no such object"
    return ""


def _is_at(each: SeenObject, meaning: QuestionMeaning) -> bool:
    left = -each.bearing_rad
    match meaning.side:
        case SeenSide.LEFT:
            is_there = left >= limit.EGO_RAD.good - _SIDE_RAD
        case SeenSide.RIGHT:
            is_there = -left >= limit.EGO_RAD.good - _SIDE_RAD
        case _:
            is_there = abs(left) <= limit.AHEAD_RAD.good + _SIDE_RAD
    if meaning.metres is None:
        return is_there
    return is_there and abs(each.range_m - meaning.metres) <= METRES.good * each.range_m + _METRES_FREE
