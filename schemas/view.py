"""View settings: what images and measurements of an episode depend on, beside its scene, poses and recorded camera.

The settings are part of a plan, travel in a job, and are recorded in the metadata. Renders nothing.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, PlainSerializer

from schemas.base import Model
from schemas.rig import Rig

RigData = Annotated[Rig, PlainSerializer(Rig.plain)]
"""Rig that is written without values that equal their default, so that a later key changes no digest."""


class ViewSettings(Model):
    """Settings of rendering that a plan, or the command that renders, chooses."""

    rig: RigData | None = Field(default=None, exclude_if=lambda rig: rig is None)
    """Sensors whose measurements are stored beside the recorded camera; null for none."""

    def describe(self) -> str:
        """Returns the settings in a few words."""
        return "the recorded camera" if self.rig is None else f"rig {self.rig.name} ({self.rig.digest[:12]})"
