"""Declares `factory bench delivery`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.options import count_option, json_option, pullers_option, record_option


@click.command("delivery")
@count_option(
    "--episodes", 40, "Number of episodes of each variant; an episode of frames takes about 0.5 MB per frame."
)
@count_option("--workers", 8, "Number of simulated workers.", most=64)
@pullers_option()
@click.option(
    "--spot-checks",
    type=click.FloatRange(0.0, 1.0),
    default=0.05,
    metavar="SHARE",
    show_default=True,
    help="Share of bundles that the coordinator validates itself in the variant with spot checks.",
)
@record_option
@json_option
def delivery(**options: Any) -> None:
    """Measure the rate at which a coordinator archives valid bundles.

    Simulated workers deliver copies of two recorded episodes over the network, with central validation and with spot
    checks of bundles that the workers have validated. The datasets are written to the directory for temporary files;
    the environment variable TMPDIR selects another one.
    """
    from factory.commands.other.bench_delivery import delivery

    delivery(**options)
