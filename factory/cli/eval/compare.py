"""Declares `factory eval compare`: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.cli.common.options import json_option
from factory.eval.models.result import Variant

_RESULTS = click.Path(path_type=Path)


@click.command("compare")
@click.argument("first", metavar="A", type=_RESULTS)
@click.argument("second", metavar="B", type=_RESULTS)
@click.option(
    "--variant",
    type=click.Choice([str(v) for v in Variant]),
    default="original",
    show_default=True,
    help="Instruction variant to compare.",
)
@json_option
def command(**options: Any) -> int:
    """Compare two policies on the episodes that both have run.

    A and B are folders OUT/policies/NAME of `factory eval -o OUT`, e.g. OUT/policies/bc:bc, or OUT if it contains one
    policy.
    """
    from factory.commands.eval.compare import execute

    return execute(**options)
