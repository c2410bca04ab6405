"""View settings, which determine images and measurements together with the scene, poses and recorded camera.

The settings are part of a plan, travel in a job, and are recorded in the metadata. Renders nothing.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, PlainSerializer

from schemas.appearance import Appearance
from schemas.base import Bytes, Model, Sha256
from schemas.rig import Rig

RigData = Annotated[Rig, PlainSerializer(Rig.plain)]
"""Rig that is serialised without values that equal their default, so keys added later change no digest."""
AppearanceData = Annotated[Appearance, PlainSerializer(Appearance.plain)]
"""Appearance that is serialised without values that equal their default, so keys added later change no digest."""


class LightFile(Model):
    """File with the light groups of a scene, which workers fetch by its digest."""

    sha256: Sha256
    """Digest of the file."""
    size: Annotated[Bytes, Field(ge=1)]
    """Size of the file, bytes."""


class ViewSettings(Model):
    """Rendering settings that a plan, or the rendering command, selects."""

    # one object for all settings, so a new one adds no field to jobs, tasks, manifests and results
    rig: RigData | None = Field(default=None, exclude_if=lambda rig: rig is None)
    """Sensors whose measurements are stored in addition to the recorded camera; null for none."""

    appearance: AppearanceData | None = Field(default=None, exclude_if=lambda it: it is None)
    """Ranges of the appearance; null shows the scene as it was compiled."""

    light: LightFile | None = Field(default=None, exclude_if=lambda it: it is None)
    """Light groups of the job's scene; null if the light is not varied."""

    def describe(self) -> str:
        shown = "the recorded camera" if self.rig is None else f"rig {self.rig.name} ({self.rig.digest[:12]})"
        return shown if self.appearance is None else f"{shown}, appearance {self.appearance.name}"
