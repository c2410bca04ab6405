"""What software and machine made an episode; recorded beside it, outside the content digest."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, StringConstraints

from schemas.base import Line, Model

__all__ = ["Fingerprint"]

_Word = Annotated[str, StringConstraints(max_length=200)]


class Fingerprint(Model):
    """Versions and machine traits that can shape the last bit of a frame (docs/design/reproducibility.md#machines)."""

    software: Annotated[dict[_Word, _Word], Field(max_length=64)]
    """Package name -> version of all that touches the bytes, our own included."""
    renderer: Line
    """The renderer's own description, e.g. the GL renderer string."""
    cpu: Line
    """CPU model name and machine type."""
