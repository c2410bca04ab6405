"""Changes of a plan that the command line requests. Imports nothing, so help pages are shown fast."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlanChanges:
    """Values that replace those of a plan; `None` or empty keeps the value of the plan.

    A field has the name of the parameter of its option (`factory.cli.options.shrink_options`).
    """

    scenes: tuple[str, ...] | None = None
    """Names of the scenes to keep."""
    episodes: int | None = None
    """Number of episodes, in the proportions of the plan."""
    expert: str | None = None
    seed: int | None = None
    """Root random seed."""
    record: str | None = None
    """Stored content: `frames` or `states`."""
    rig: str | None = None
    """Name of a built-in rig, or path of a TOML file."""
    appearance: str | None = None
    """Name of a built-in appearance, or path of a TOML file."""
