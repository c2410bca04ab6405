"""Masks over the objects of a scene graph: where a property surely holds, and where it possibly holds."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from schemas.language.expression import Landmark
from schemas.language.thresholds import Band
from schemas.support.numpy_types import Bools, Floats, Ints


class Masks(NamedTuple):
    """Objects for which a property holds; arrays of any shape whose last axis is the object."""

    sure: Bools
    """Objects for which it surely holds."""
    possible: Bools
    """Objects for which it possibly holds; includes those for which it surely holds."""

    def both(self, other: Masks) -> Masks:
        """Returns the masks of the objects that have both properties."""
        return Masks(self.sure & other.sure, self.possible & other.possible)

    def of_any(self, landmarks: Described) -> Masks:
        """Returns the objects that have this relation, (N, N) [landmark, object], to any of the given landmarks."""
        sure = np.asarray(self.sure[landmarks.sure].any(axis=0), bool)
        return Masks(sure, np.asarray(self.possible[landmarks.possible].any(axis=0), bool))

    def fits_only(self, number: int) -> bool:
        """Returns whether the property surely holds for an object, and surely does not hold for any other object."""
        return bool(self.sure[number]) and int(self.possible.sum()) == 1


class Described(NamedTuple):
    """Description of a landmark, and the objects that it fits."""

    landmark: Landmark
    """Description."""
    masks: Masks
    """Objects that it fits."""
    sure: Ints
    """Numbers of the objects that it surely fits."""
    possible: Ints
    """Numbers of the objects that it possibly fits."""


def below(values: Floats, band: Band) -> Masks:
    """Returns the masks of the values that are small enough: surely up to `good`, possibly below `bad`."""
    return Masks(values <= band.good, values < band.bad)


def above(values: Floats, band: Band) -> Masks:
    """Returns the masks of the values that are large enough: surely from `good`, possibly above `bad`."""
    return Masks(values >= band.good, values > band.bad)
