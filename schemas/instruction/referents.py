"""Determines which objects of a scene an instruction fits, and which objects an image shows.

Plan expansion, simulation, validation and statistics share these pure functions. They read no file.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from schemas.episode_spec import EpisodeSpec
from schemas.instruction.templates import TEMPLATES, needs_colour
from schemas.scene import SceneInfo


def named_colour(template_id: str, colour: str) -> str | None:
    """Returns the colour that an instruction names, or `None` if its template has no colour slot.

    Args:
        template_id: template of the instruction; a template that does not exist names no colour.
        colour: colour word of the target, or `unknown`.
    """
    return colour if template_id in TEMPLATES and needs_colour(template_id) else None


def referents(info: SceneInfo, category: str, colour: str | None = None) -> frozenset[int]:
    """Returns the instance ids of all objects of a category, and of a colour if one is named.

    An object of the category that is not a target, because the robot cannot reach it, has no recorded colour; it fits
    every colour. A target without a dominant colour (`unknown`) fits no named colour.

    Args:
        info: metadata of the scene.
        category: category that the instruction names.
        colour: colour that the instruction names; `None` if it names none.
    """
    colours = {target.instance_id: target.colour for target in info.targets}
    return frozenset(
        instance.id
        for instance in info.instances
        if instance.category == category and (colour is None or colours.get(instance.id, colour) == colour)
    )


def referents_of(spec: EpisodeSpec, info: SceneInfo) -> frozenset[int]:
    """Returns the instance ids of all objects of the scene that the instruction of an episode fits.

    The instruction is ambiguous in the scene if there are two or more.
    """
    return referents(info, spec.category, named_colour(spec.template_id, spec.colour))


def ids_in_view(ids: NDArray[np.uint16], min_pixels: int) -> frozenset[int]:
    """Returns the instance ids that an image shows; the id 0 of pixels without an object is not among them.

    Args:
        ids: (H, W) instance ids of the image.
        min_pixels: smallest mask of a visible object, pixels (`gains.min_mask_px` of the job).
    """
    pixels = np.bincount(ids.reshape(-1))
    return frozenset((np.flatnonzero(pixels[1:] >= min_pixels) + 1).tolist())
