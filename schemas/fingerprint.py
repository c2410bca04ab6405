"""What software and machine made an episode; recorded beside it, outside the content digest."""

from __future__ import annotations

from schemas.base import Model

__all__ = ["Fingerprint"]


class Fingerprint(Model):
    """Versions and machine traits that can shape the last bit of a frame (DESIGN 3.14)."""

    software: dict[str, str]
    """Package name -> version of all that touches the bytes, our own included."""
    renderer: str
    """The renderer's own description, e.g. the GL renderer string."""
    cpu: str
    """CPU model name and machine type."""
