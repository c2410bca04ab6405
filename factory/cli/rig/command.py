"""Declares `factory rig`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import complete_rig, count_option, json_option
from schemas.builtin import DEFAULT_CONTROL_HZ

_rig_argument = click.argument("rig", metavar="RIG", shell_complete=complete_rig)
_control_option = count_option(
    "--control-hz", DEFAULT_CONTROL_HZ, "Control rate that the rates of the sensors must divide, Hz.", most=240
)


@click.group("rig", cls=CommandGroup)
def command() -> None:
    """List, show and check sensor rigs."""


@command.command("list")
@json_option
def list_(**options: Any) -> None:
    """List the built-in rigs."""
    from factory.commands.rig.command import list_

    list_(**options)


@command.command("show")
@_rig_argument
@_control_option
@click.option("--toml", "as_toml", is_flag=True, help="Print the rig as TOML, to edit it.")
@json_option
def show(**options: Any) -> None:
    """Show the sensors of a rig.

    RIG is a built-in rig (see `factory rig list`) or a TOML file.
    """
    from factory.commands.rig.command import show

    show(**options)


@command.command("check")
@_rig_argument
@_control_option
@json_option
def check(**options: Any) -> None:
    """Check a rig file, and that its cameras can be rendered.

    RIG is a built-in rig or a TOML file. Exits with 2 and lists all mistakes if the rig is not valid.
    """
    from factory.commands.rig.command import check

    check(**options)
