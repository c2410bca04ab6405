"""Registry of the figures of a report, in the order of the page. A new figure needs one module and one line here."""

from __future__ import annotations

from factory.report.drawing.figure import DrawFunction
from factory.report.figures import (
    action_space,
    attempts,
    categories,
    errors,
    fit,
    language,
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

DRAW_FUNCTIONS: tuple[DrawFunction, ...] = (
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
    language.draw,
    attempts.draw,
)
