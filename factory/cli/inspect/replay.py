"""Declares `factory replay`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import json_option, place_argument, renderer_option


@click.command("replay")
@place_argument
@click.argument("episode")
@renderer_option
@json_option
def command(**options: Any) -> int:
    """Simulate one episode again and compare its content.

    EPISODE is a name or number: ep_000001 or 1. Exits with 1 if the content differs.
    """
    from factory.commands.inspect.replay import execute

    return execute(**options)
