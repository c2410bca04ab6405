"""The base of every shared model, and bounded kinds of numbers and text; nothing of the domain is defined here.

Whatever a peer sends is read into these kinds, so that no number, text or list of it can be larger than a bound.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

__all__ = [
    "MAX_COUNT",
    "MAX_ROWS",
    "Bytes",
    "Count",
    "Finite",
    "Fraction",
    "Line",
    "Model",
    "Name",
    "NonNegative",
    "Ordinal",
    "Positive",
    "PrimPath",
    "RowId",
    "Sha256",
    "Text",
]

MAX_COUNT = 2**31 - 1
"""Largest number of an INTEGER column."""
MAX_ROWS = 10**15 - 1
"""Largest number of a row; it has 15 digits, as many as a selector may have."""
_MOST = 1e9
"""Largest magnitude of a measured value, in its SI unit."""


class Model(BaseModel):
    """Frozen, closed to unknown fields, free of NaN and infinity: what crosses a process, file or package."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="null")


Name = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
"""A lower-case identifier of at most 64 characters."""

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
"""A SHA-256 digest as 64 hexadecimal digits."""

Line = Annotated[str, StringConstraints(max_length=500)]
"""A name, a version or a sentence."""

Text = Annotated[str, StringConstraints(max_length=10_000)]
"""A message of several lines."""

PrimPath = Annotated[str, StringConstraints(max_length=4096)]
"""Path of a USD prim."""

Count = Annotated[int, Field(ge=0, le=MAX_COUNT)]
"""How many."""

Ordinal = Annotated[int, Field(ge=1, le=MAX_COUNT)]
"""A number that begins at 1."""

RowId = Annotated[int, Field(ge=1, le=MAX_ROWS)]
"""Number of a row in a database."""

Bytes = Annotated[int, Field(ge=0, le=1 << 40)]
"""Size of a file."""

Finite = Annotated[float, Field(ge=-_MOST, le=_MOST)]
Positive = Annotated[float, Field(gt=0, le=_MOST)]
NonNegative = Annotated[float, Field(ge=0, le=_MOST)]
Fraction = Annotated[float, Field(ge=0, le=1)]
