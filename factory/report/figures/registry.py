"""All figures of a report, in the order of the page."""

from __future__ import annotations

from factory.report.drawing.figure import Drawer
from factory.report.figures import (
    action_space,
    attempts,
    categories,
    errors,
    fit,
    lengths,
    samples,
    spawn_maps,
    splits,
    steps,
    templates,
    tier_statistics,
    tiers,
    tracks,
)

__all__ = ["DRAWERS"]

DRAWERS: tuple[Drawer, ...] = (
    samples.draw,
    action_space.draw,
    tiers.draw,
    spawn_maps.draw,
    tracks.draw,
    splits.draw,
    categories.draw,
    lengths.draw,
    errors.draw,
    steps.draw,
    tier_statistics.draw,
    fit.draw,
    templates.draw,
    attempts.draw,
)
