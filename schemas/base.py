"""Base class of every shared model, and bounded types of numbers and text. Defines no type of the domain.

Messages of a peer are parsed into these types, so every number, text and list in them is bounded.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

MAX_COUNT = 2**31 - 1
"""Largest value of an INTEGER column."""
MAX_ROWS = 10**15 - 1
"""Largest row id; it has 15 digits, which is the limit of a number in a selector."""
_MOST = 1e9
"""Largest magnitude of a measured value, in its SI unit."""


class Model(BaseModel):
    """Base class of data exchanged between processes, files or packages: frozen, no unknown fields, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="null")


Name = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
"""Lower-case identifier of at most 64 characters."""

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
"""SHA-256 digest as 64 hexadecimal digits."""

Line = Annotated[str, StringConstraints(max_length=500)]
"""Text of one line, such as a name, a version or a sentence; at most 500 characters."""

Text = Annotated[str, StringConstraints(max_length=10_000)]
"""Text of several lines; at most 10 000 characters."""

PrimPath = Annotated[str, StringConstraints(max_length=4096)]
"""Path of a prim: a USD prim, or a node of a different format below `/World`."""

Count = Annotated[int, Field(ge=0, le=MAX_COUNT)]
"""Number of items, from 0."""

Ordinal = Annotated[int, Field(ge=1, le=MAX_COUNT)]
"""Number in a sequence, from 1."""

RowId = Annotated[int, Field(ge=1, le=MAX_ROWS)]
"""Id of a database row, from 1."""

Bytes = Annotated[int, Field(ge=0, le=1 << 40)]
"""Size of a file, bytes; at most 1 TiB."""

Finite = Annotated[float, Field(ge=-_MOST, le=_MOST)]
"""Measured value of any sign."""
Positive = Annotated[float, Field(gt=0, le=_MOST)]
"""Measured value above 0."""
NonNegative = Annotated[float, Field(ge=0, le=_MOST)]
"""Measured value of at least 0."""
Fraction = Annotated[float, Field(ge=0, le=1)]
"""Value from 0 to 1."""
