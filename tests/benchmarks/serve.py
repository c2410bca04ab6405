"""Benchmarks the web page of a dataset: times of pages and frames, rate of playback, and the cost of open tabs.

The server runs in another process, with the same Python interpreter. CPU times are those of the server.

    python -m tests.benchmarks.serve DIR
"""

from __future__ import annotations

import http.client
import os
import socket
import subprocess
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np

from factory.bench.machine import describe_machine
from factory.bench.results import Machine, Spread
from factory.bench.tables import print_machine, range_text
from factory.cli.options import count_option, json_option, number_option, place_argument
from factory.dataset.reader import Dataset
from factory.support.terminal import print_result, print_table
from schemas.base import Model
from schemas.errors import WorldError
from schemas.storage.place import Place
from schemas.support.child import child_environment, python_module
from schemas.support.extras import require_package
from schemas.terms import Recording
from tests.benchmarks.command import run
from workers.client.stopping import signals_deferred

_SEED = 24
_TICK_S = 1 / os.sysconf("SC_CLK_TCK")
_IN_FLIGHT = 12
"""Number of frames that the player of the page requests ahead."""
_SMALL = ("playback/{}?kind=depth", "playback/{}?kind=ids")
_TABLES = (
    "/episodes",
    "/episodes?page=1",
    "/episodes?sort=num_steps&order=desc",
    "/episodes?split=val_id&sort=final_ne_m",
    "/episodes?q=chair",
    "/episodes?q=chair&page=3",
)


class RequestCost(Model):
    """Cost of one kind of request."""

    first_ms: float
    """Wall time of the first request, milliseconds."""
    wall_ms: Spread
    """Wall time of the other requests, milliseconds."""
    cpu_ms: float
    """Mean CPU time of the server for one of the other requests, milliseconds."""


class ServeBench(Model):
    """Measurements of the web page of a dataset."""

    machine: Machine
    episodes: int
    first_page: RequestCost
    table_page: dict[str, RequestCost]
    """Path of a table page -> cost of its requests."""
    first_frame: RequestCost
    """Cost of the first colour frame of an episode. Each request is for another episode, which the server must open."""
    frames_per_s: float
    """Frames of an episode that the server supplies per second; a frame has colour, depth and ids."""
    frame_cpu_ms: float
    """CPU time of the server for one frame with colour, depth and ids, milliseconds."""
    tabs: int
    tabs_s: float
    """Time for which the tabs were open, seconds."""
    tabs_core_share: float
    """CPU time of the server per second of wall time while the tabs were open."""
    idle_core_share: float
    """CPU time of the server per second of wall time before the tabs were opened."""


def bench_serve(root: Place, repeats: int, tabs: int, seconds: float) -> ServeBench:
    """Starts the server of a dataset and measures it.

    Args:
        root: dataset, whose run may be in progress.
        repeats: number of timed requests of each page.
        tabs: number of open farm pages.
        seconds: duration of each measurement of the CPU time, without and with open farm pages, seconds.

    Raises:
        WorldError: the server does not start.
    """
    dataset = Dataset(root)
    with _server(root) as (host, pid):
        first = _cost(host, pid, ["/farm"] * (repeats + 1))
        tables = {path: _cost(host, pid, [path] * (repeats + 1)) for path in _TABLES}
        names = _draw(dataset, repeats + 1)
        frames = _cost(host, pid, [f"/episodes/{name}/frames/0.png" for name in names])
        rate, cpu_ms = _play(host, pid, dataset, names[0])
        idle = _share(pid, seconds)
        with ExitStack() as stack:
            for _ in range(tabs):
                open_tab(host, stack)
            busy = _share(pid, seconds)
    return ServeBench(
        machine=describe_machine(),
        episodes=len(dataset),
        first_page=first,
        table_page=tables,
        first_frame=frames,
        frames_per_s=rate,
        frame_cpu_ms=cpu_ms,
        tabs=tabs,
        tabs_s=seconds,
        tabs_core_share=busy,
        idle_core_share=idle,
    )


@contextmanager
def measured_process(command: Sequence[str], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """Yields a process that gets SIGTERM at the end of the block, even if a signal interrupts its start.

    Args:
        command: command line.
        options: options of `subprocess.Popen`.
    """
    with ExitStack() as stack:
        with signals_deferred():
            process = stack.enter_context(subprocess.Popen(command, env=child_environment(os.environ), **options))
            stack.callback(process.terminate)
        yield process


@contextmanager
def _server(root: Place) -> Iterator[tuple[str, int]]:
    """Yields address and process id of a server."""
    command = python_module("factory", "serve", str(root), "--http", "127.0.0.1:0")
    with measured_process(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        if "http://" not in line:
            raise WorldError(f"`factory serve {root}` did not start; see its message above")
        yield line.partition("http://")[2].partition("/")[0], process.pid


def _cost(host: str, pid: int, paths: Sequence[str]) -> RequestCost:
    first = ask_page(host, paths[0])
    begin_cpu_s = _cpu_s(pid)
    others = [ask_page(host, path) for path in paths[1:]]
    cpu_ms = 1000 * (_cpu_s(pid) - begin_cpu_s) / len(others)
    return RequestCost(first_ms=first, wall_ms=Spread.of(others), cpu_ms=cpu_ms)


def ask_page(host: str, path: str) -> float:
    """Returns the wall time of a request, milliseconds.

    Raises:
        WorldError: the server does not answer with the page.
    """
    begin_s = time.perf_counter()
    connection = http.client.HTTPConnection(host, timeout=600)
    connection.request("GET", path, headers={"Accept": "*/*"})
    reply = connection.getresponse()
    body = reply.read()
    connection.close()
    if reply.status != 200:
        raise WorldError(f"{path}: the server answered {reply.status}: {body[:200].decode(errors='replace')}")
    return 1000 * (time.perf_counter() - begin_s)


def _draw(dataset: Dataset, count: int) -> list[str]:
    rng = np.random.default_rng(_SEED)
    positions = rng.choice(len(dataset), size=min(count, len(dataset)), replace=False)
    names: list[str] = dataset.column("episode_id").take(positions).to_pylist()
    return names


def _play(host: str, pid: int, dataset: Dataset, name: str) -> tuple[float, float]:
    """Requests frames of an episode as the player does; returns frames per second and CPU milliseconds per frame."""
    steps = range(1, len(dataset[name]), 2)
    is_stored = dataset.meta.plan.record is Recording.FRAMES
    paths = ("frames/{}.png?kind=rgb" if is_stored else "playback/{}?kind=rgb", *_SMALL)

    def frame(t: int) -> None:
        for path in paths:
            ask_page(host, f"/episodes/{name}/{path.format(t)}")

    begin_s, begin_cpu_s = time.perf_counter(), _cpu_s(pid)
    with ThreadPoolExecutor(_IN_FLIGHT) as pool:
        list(pool.map(frame, steps))
    wall_s = time.perf_counter() - begin_s
    return len(steps) / wall_s, 1000 * (_cpu_s(pid) - begin_cpu_s) / len(steps)


def open_tab(host: str, stack: ExitStack) -> None:
    """Opens the stream of live updates of a farm page; closing the stack closes the stream."""
    name, _, port = host.rpartition(":")
    tab = stack.enter_context(socket.create_connection((name, int(port)), timeout=60))
    tab.sendall(b"GET /live HTTP/1.1\r\nHost: localhost\r\n\r\n")


def _share(pid: int, seconds: float) -> float:
    begin_s, begin_cpu_s = time.perf_counter(), _cpu_s(pid)
    time.sleep(seconds)
    return (_cpu_s(pid) - begin_cpu_s) / (time.perf_counter() - begin_s)


def _cpu_s(pid: int) -> float:
    """Returns the CPU time of a process and of its children, seconds."""
    return cpu_s_of([pid, *_children(pid)])


def cpu_s_of(pids: Iterable[int]) -> float:
    """Returns the CPU time of running processes, seconds."""
    total = 0.0
    for place in pids:
        fields = Path(f"/proc/{place}/stat").read_text().rpartition(")")[2].split()
        total += (int(fields[11]) + int(fields[12])) * _TICK_S
    return total


def _children(pid: int) -> Sequence[int]:
    return [
        int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()
    ]


@click.command()
@place_argument
@count_option("--repeats", 10, "Number of timed requests of each page.", least=2)
@count_option("--tabs", 100, "Number of open farm pages.", most=300)
@number_option("SECONDS", "--seconds", 60.0, "Time for which the tabs are open, seconds.", least=1.0)
@json_option
def command(root: Place, repeats: int, tabs: int, seconds: float, as_json: bool) -> None:
    """Measure the web page of a dataset, or of a run in progress.

    Starts `factory serve` and measures its pages, frames and playback, and its CPU time with and without open tabs.
    """
    require_package("starlette", "this benchmark")
    print_result(bench_serve(root, repeats, tabs, seconds), as_json, _show)


def _show(report: ServeBench) -> None:
    print_machine(report.machine)
    pages: dict[str, RequestCost] = {"/farm": report.first_page, **report.table_page, "first frame": report.first_frame}
    rows = [
        (
            path,
            *(round(value, 1) for value in (cost.first_ms, cost.wall_ms.median)),
            range_text(cost.wall_ms),
            cost.cpu_ms,
        )
        for path, cost in pages.items()
    ]
    columns = ("request", "first, ms", "median, ms", "range", "CPU, ms")
    print_table(f"Web page of {report.episodes} episodes", columns, rows)
    click.echo(f"\nplayback: {report.frames_per_s:.1f} frames/s, {report.frame_cpu_ms:.1f} ms of CPU time per frame")
    share, idle = 100 * report.tabs_core_share, 100 * report.idle_core_share
    click.echo(f"{report.tabs} open tabs for {report.tabs_s:.0f} s: {share:.2f} % of a core, {idle:.2f} % without tabs")


if __name__ == "__main__":
    run(command)
