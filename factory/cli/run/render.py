"""Declares `factory render`: arguments, options and help."""

from __future__ import annotations

from typing import Any

import click

from factory.cli.common.options import (
    appearance_option,
    json_option,
    out_option,
    place_argument,
    renderer_option,
    rig_option,
    verbose_option,
    workers_option,
)


@click.command("render")
@place_argument
@out_option
@rig_option(
    "Sensors to store: a built-in rig or a TOML file; `paper` is the recorded camera, which is always stored. With "
    "several rigs, the dataset of each rig is OUT/NAME. Default: the plan's rig.",
    multiple=True,
)
@appearance_option("Default: the plan's.")
@workers_option("Number of rendering processes")
@renderer_option
@json_option
@verbose_option
def command(**options: Any) -> int:
    """Render the frames and sensors of a states dataset.

    The result has the episodes and the digest that `factory run --record frames` gives. After Ctrl-C or a crash, the
    same command continues. Exits with 1 if episodes are missing at the end.
    """
    from factory.commands.run.render import execute

    return execute(**options)
