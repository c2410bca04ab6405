"""Model of the software and machine that made an episode; recorded in its provenance, outside the content digest."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, StringConstraints

from schemas.base import Line, Model

_Word = Annotated[str, StringConstraints(max_length=200)]


class Fingerprint(Model):
    """Versions and machine properties that may affect a frame's bytes (docs/design/reproducibility.md#machines)."""

    software: Annotated[dict[_Word, _Word], Field(max_length=64)]
    """Versions, by package name, of all software that affects the recorded bytes, this product included."""
    renderer: Line
    """Description that the renderer gives of itself, e.g. the GL renderer string."""
    cpu: Line
    """CPU model name and machine type."""
