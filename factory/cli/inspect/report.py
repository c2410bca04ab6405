"""Declares `factory report`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import compare_option, json_option, place_argument, write_option


@click.command("report")
@place_argument
@write_option("DIR", "Output folder. An existing report is replaced.", required=True)
@click.option("--force", is_flag=True, help="Allow a folder that contains other files; they are kept.")
@compare_option
@json_option
def command(**options: Any) -> int:
    """Write an HTML report with figures of a dataset.

    Writes report.html and figures/ to --out; the page works offline. Exits with 1 if damaged episodes were skipped; the
    page lists them.
    """
    from factory.commands.inspect.report import execute

    return execute(**options)
