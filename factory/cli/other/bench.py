"""Declares `factory bench`: arguments, options and help."""

from __future__ import annotations

import os
import signal
from typing import Any

import click

from factory.cli.groups import CommandGroup
from factory.cli.options import (
    PLACE,
    count_option,
    json_option,
    plan_argument,
    pullers_option,
    record_option,
    renderer_option,
    scene_filter,
    workers_option,
)
from factory.cli.other.bench_dataset import dataset
from factory.cli.other.bench_delivery import delivery
from factory.cli.other.bench_serve import serve
from factory.cli.other.bench_sessions import sessions
from factory.cli.other.bench_visited import visited
from schemas.encoding.image_sizes import FRAME_SIZE_PX, MAX_SIZE_PX
from schemas.terms import ExpertName, Recording

# numpy and Mesa read these variables when they are imported; the benchmarks measure one process on one core
os.environ.setdefault("LP_NUM_THREADS", "0")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

_PLAIN_FRAMES = 24


_repeats_option = count_option("--repeats", 3, "Number of timed runs; the result is their median.")
_size_option = count_option("--size", FRAME_SIZE_PX, "Width and height of the frames, pixels.", most=MAX_SIZE_PX)
_antialias_option = count_option(
    "--antialias", 1, "Samples per pixel along each axis; colours are their mean.", most=16
)


@click.group("bench", cls=CommandGroup)
def command() -> None:
    """Measure the performance of this machine.

    Each result is the median over repeated runs of the same work.
    """
    from factory.support.logs import configure_logs

    configure_logs(verbose=False)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the measured processes, too


@command.command("rollout")
@plan_argument(default="paper")
@scene_filter()
@count_option("--episodes", 8, "Number of episodes of each scene.")
@_repeats_option
@record_option
@click.option("--against", type=click.Choice(["plain"]), help="Also measure a plain PyBullet pipeline for comparison.")
@count_option("--frames", _PLAIN_FRAMES, "Number of frames of the plain pipeline.", least=2)
@renderer_option
@json_option
def rollout(**options: Any) -> None:
    """Measure the speed of collection on one core.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: paper. Includes physics,
    control, rendering, encoding and writing of the bundle. `frames_per_s_per_core` uses wall-clock time.
    `frames_per_cpu_s` uses CPU time of the process, which does not depend on the load of the machine.
    """
    from factory.commands.other.bench import rollout

    rollout(**options)


@command.command("collect")
@plan_argument(default="paper")
@scene_filter()
@count_option("--episodes", 100, "Number of episodes of each run.")
@click.option(
    "--record",
    "records",
    type=click.Choice([str(kind) for kind in Recording]),
    multiple=True,
    help="Kind of recording to measure; repeatable.",
)
@click.option(
    "--expert",
    "experts",
    type=click.Choice([str(name) for name in ExpertName]),
    multiple=True,
    help="Expert to measure; repeatable.",
)
@workers_option("Number of simulation processes")
@_repeats_option
@renderer_option
@json_option
def collect(**options: Any) -> None:
    """Measure whole runs: episodes per hour and CPU time per episode.

    PLAN is a built-in plan (demo, paper, balanced, referring) or a TOML file; default: paper. Runs every combination
    of --record and --expert, in turns. Default: the recording and the expert of the plan.
    """
    from factory.commands.other.bench import collect

    collect(**options)


@command.command("render")
@scene_filter()
@count_option("--frames", 60, "Number of poses in each scene.")
@_size_option
@_antialias_option
@_repeats_option
@renderer_option
@json_option
def render(**options: Any) -> None:
    """Measure the speed of rendering.

    All runs render the same random poses of each scene, on one core: colour, depth and ids.
    """
    from factory.commands.other.bench_frames import render

    render(**options)


@command.command("memory")
@scene_filter()
@count_option("--episodes", 200, "Total number of episodes; most are ended early.", least=20)
@renderer_option
@json_option
def memory(**options: Any) -> None:
    """Measure the memory of a simulation over many episodes.

    The process switches to another scene after each episode.
    """
    from factory.commands.other.bench import memory

    memory(**options)


@command.command("coordinator")
@count_option("--jobs", 100_000, "Number of jobs in the ledger.", least=1000, most=5_000_000)
@count_option("--workers", 64, "Number of concurrent simulated workers.", most=64)
@count_option("--sessions", 2000, "Number of concurrent network sessions.", most=4000)
@count_option("--bundle-mb", 32, "Size of each worker's bundle, MB.", most=256)
@pullers_option()
@_repeats_option
@json_option
def coordinator(**options: Any) -> None:
    """Measure a coordinator with a large ledger.

    Measures leases and submissions of real bundles, by direct calls and over the network. The memory is that of a
    separate coordinator process with all sessions connected, and while all workers send a bundle at the same time.
    """
    from factory.commands.other.bench import coordinator

    coordinator(**options)


command.add_command(dataset)
command.add_command(serve)
command.add_command(delivery)
command.add_command(sessions)
command.add_command(visited)


@command.command("read")
@click.argument("root", metavar="[DIR|URL]", required=False, type=PLACE)
@scene_filter()
@count_option("--frames", 500, "Number of random frames per run.")
@_size_option
@_antialias_option
@workers_option("Number of worker processes of the PyTorch DataLoader.", default=2, least=0)
@_repeats_option
@json_option
def read(**options: Any) -> None:
    """Measure random access to the frames of a dataset.

    Without DIR or URL, a few episodes of each scene are generated first.
    """
    from factory.commands.other.bench_frames import read

    read(**options)
