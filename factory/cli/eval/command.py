"""Declares `factory eval`: arguments, options and help."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from factory.cli.common.groups import DefaultCommand, DefaultGroup
from factory.cli.common.options import (
    appearance_option,
    connect_option,
    count_option,
    former_option,
    json_option,
    listen_option,
    number_option,
    renderer_option,
    rig_option,
    tls_option,
    workers_option,
    write_option,
)
from factory.cli.common.places import DIRECTORY
from factory.cli.eval.compare import command as compare_command
from factory.cli.eval.specs import command as specs_command
from factory.cli.eval.splits import eval_split_filter


@click.group("eval", cls=DefaultGroup)
def command() -> None:
    """Evaluate policies in closed loop on the episodes of a dataset."""


@click.command("run", cls=DefaultCommand, hidden=True)
@click.argument("root", metavar="DIR", type=DIRECTORY)
@former_option("--data", "root", "DIR", type=DIRECTORY)
@eval_split_filter
@click.option(
    "--policy", "policies", multiple=True, metavar="POLICY", help="Policy to evaluate, see above; repeatable."
)
@click.option(
    "--specs",
    "specs_path",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="File of evaluation episodes, written by `factory eval specs`. Default: the episodes of the dataset.",
)
@click.option(
    "--ablate-language", is_flag=True, help="Also evaluate with shuffled, wrong-category and empty instructions."
)
@count_option("--episodes", None, "Number of episodes, selected at even intervals. Default: all.")
@workers_option("Number of simulation processes on this machine")
@listen_option("Endpoint to listen on; `factory worker` processes that connect run the episodes. Repeatable.")
@connect_option("Endpoint of a running coordinator whose workers run the episodes; repeatable.")
@tls_option
@write_option(
    "DIR",
    "Output directory. An interrupted evaluation with the same options is continued. Default: no output files.",
)
@number_option("SECONDS", "--act-timeout", 10.0, "Timeout for each action, seconds.", least=0.01)
@number_option(
    "SECONDS", "--load-timeout", 300.0, "Timeout for loading the policy and for each reset, seconds.", least=0.1
)
@click.option(
    "--pose", "with_pose", is_flag=True, help="Add the robot's pose, in the start frame, to the observations."
)
@rig_option(
    "Sensors that policies get: a built-in rig or a TOML file. A policy that needs another sensor is refused. Default: "
    "the recorded camera."
)
@appearance_option("Default: the scenes as they were compiled.")
@count_option("--videos", 12, "Maximum number of videos of failed episodes for each policy.", least=0)
@click.option("--tables", "all_tables", is_flag=True, help="Also print tables by scene, tier, category and template.")
@renderer_option
@json_option
def run(**options: Any) -> int:
    """Evaluate policies in closed loop on the episodes of a dataset.

    \b
    POLICY is one of
      built-in:  expert, planner, random, stop, bc:DIR,
                 replay (recorded actions of the same episode),
                 playback (recorded actions of another episode)
      a class:   package.module:Class (see docs/evaluation/README.md)
      a server:  ws://HOST:PORT (openpi's protocol: WebSocket and msgpack)

    Writes episodes.parquet, results.json and index.html to --out. The same command continues an interrupted evaluation.
    """
    from factory.commands.eval.command import run

    return run(**options)


command.set_default(run)
command.add_command(specs_command)
command.add_command(compare_command)
