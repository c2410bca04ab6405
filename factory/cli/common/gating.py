"""`--gate`: whether the success rate of first attempts is measured before a run. Measures nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from factory.commands.common.gate_mode import GATE_ATTEMPTS, MIN_EPISODES_FOR_GATE, MIN_SUCCESS, GateMode

Command = TypeVar("Command", bound=Callable[..., Any])

_MEANINGS = (
    f"Gate before a new run: {GATE_ATTEMPTS} first attempts in each scene. enforce: exit with 1 if less than "
    f"{100 * MIN_SUCCESS:.0f} % succeed; report: record the result and continue; skip: no gate"
)


def gate_option(default: GateMode) -> Callable[[Command], Command]:
    """Returns the option `--gate MODE`."""
    modes = ["enforce", "report", "skip"]
    if default == "auto":
        modes.insert(0, default)
    auto = (
        f"; auto: report for scenes with at least {MIN_EPISODES_FOR_GATE} episodes, otherwise skip"
        if default == "auto"
        else ""
    )
    return click.option(
        "--gate", "gate_mode", type=click.Choice(modes), default=default, show_default=True, help=f"{_MEANINGS}{auto}."
    )
