"""Measures what visitors of the web page cost a run.

Periods without visitors, with viewers and with attackers alternate. The run is `factory run --http` in another
process, with its coordinator and its workers. CPU times are those of the run. The visitors use the same CPU cores,
which lowers the episode rate but does not raise the CPU time per episode.

    python -m tests.benchmarks.visited demo --seconds 60
"""

from __future__ import annotations

import math
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click

from factory.bench.machine import describe_machine
from factory.bench.results import Machine, Spread
from factory.cli.options import count_option, json_option, number_option, plan_argument, workers_option
from factory.dataset.reader import Dataset
from factory.dataset.site import Site, site_of
from factory.runs.ledger import progress_in, read_ledger
from factory.support.terminal import print_result, print_table
from schemas.base import Model
from schemas.errors import WorldError
from schemas.plan import MAX_EPISODES
from schemas.storage.dataset_files import META_FILE
from schemas.support.child import python_module
from schemas.support.extras import require_package
from tests.benchmarks.attack import flood, slow_clients
from tests.benchmarks.command import run
from tests.benchmarks.serve import ask_page, cpu_s_of, measured_process, open_tab

_EPISODES_PER_S = 20
"""Planned episodes per worker and second; a worker completes fewer, so the run does not end too early."""
_SLOW_CLIENTS = 100
_VISIT_S = 10.0
"""Pause of a viewer between two visits of the pages, seconds."""
_POLL_S = 0.5


class VisitorCost(Model):
    """Measurements of the run in all periods with one kind of visitors."""

    episodes_per_s: Spread
    coordinator_share: Spread
    """CPU time of the coordinator process, which serves the web page, per second of wall time."""
    cpu_s_per_episode: Spread
    """CPU time of all processes of the run per archived episode, seconds."""


class VisitedBench(Model):
    """Cost of visitors of the web page of a run."""

    machine: Machine
    plan: str
    seconds: float
    """Duration of each period, seconds."""
    rounds: int
    requests: int
    """Number of hostile requests of each period with attackers."""
    viewers: int
    costs: dict[str, VisitorCost]
    """Cost by kind of visitors: `none`, `viewers`, `attackers`."""


def bench_visited(plan: str, workers: int, seconds: float, rounds: int, viewers: int, requests: int) -> VisitedBench:
    """Starts a run with `--record states` and measures it in alternating periods.

    Args:
        plan: name or file of a plan.
        workers: number of simulations.
        seconds: duration of each period, seconds.
        rounds: number of periods of each kind.
        viewers: number of viewers.
        requests: number of hostile requests of a period.

    Raises:
        WorldError: the run does not start, or ends before the last period.
    """
    kinds: dict[str, Callable[[str, Site], None]] = {
        "none": lambda _host, _site: time.sleep(seconds),
        "viewers": lambda host, site: _view(host, site, viewers, seconds),
        "attackers": lambda host, _site: _attack(host, requests, seconds),
    }
    machine = describe_machine()
    found: dict[str, list[tuple[float, float, float]]] = {kind: [] for kind in kinds}
    episodes = min(MAX_EPISODES, math.ceil(len(kinds) * rounds * seconds * workers * _EPISODES_PER_S))
    with _run(plan, episodes, workers) as (host, pid, site):
        while not (site.state_dir / META_FILE).is_file():  # written when scenes and workers are ready
            time.sleep(_POLL_S)
        for _ in range(rounds):
            for kind, visit in kinds.items():
                found[kind].append(_measure(pid, site, lambda visit=visit: visit(host, site)))  # type: ignore[misc]
    costs = {
        kind: VisitorCost(
            episodes_per_s=Spread.of([rate for rate, _, _ in periods]),
            coordinator_share=Spread.of([share for _, share, _ in periods]),
            cpu_s_per_episode=Spread.of([cost for _, _, cost in periods]),
        )
        for kind, periods in found.items()
    }
    return VisitedBench(
        machine=machine,
        plan=plan,
        seconds=seconds,
        rounds=rounds,
        requests=requests,
        viewers=viewers,
        costs=costs,
    )


@contextmanager
def _run(plan: str, episodes: int, workers: int) -> Iterator[tuple[str, int, Site]]:
    """Yields the address of the page, the process id and the location of a run."""
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        out, log = Path(folder) / "out", Path(folder) / "log"
        words = (plan, "--episodes", episodes, "--record", "states", "--gate", "skip", "--workers", workers)
        command = python_module("factory", "run", *map(str, words), "--out", str(out), "--http", "127.0.0.1:0")
        with log.open("wb") as errors, measured_process(command, stdout=subprocess.DEVNULL, stderr=errors) as process:
            while "http://" not in log.read_text(errors="replace"):
                if process.poll() is not None:
                    text = log.read_text(errors="replace")
                    raise WorldError(f"`factory run {plan}` did not start:\n{text[-2000:]}")
                time.sleep(_POLL_S)
            host = log.read_text(errors="replace").partition("http://")[2].partition("/")[0]
            yield host, process.pid, site_of(str(out))


def _measure(pid: int, site: Site, visit: Callable[[], None]) -> tuple[float, float, float]:
    """Returns episodes per second, CPU share of the coordinator and CPU seconds per episode during a visit."""
    begin_s, done, own, whole = time.monotonic(), _archived(site), cpu_s_of([pid]), cpu_s_of(_family(pid))
    visit()
    wall_s, episodes = time.monotonic() - begin_s, _archived(site) - done
    if not episodes:
        raise WorldError(f"no episode was archived in {wall_s:.0f} s: give longer periods with --seconds")
    cpu_s = cpu_s_of(_family(pid)) - whole
    return episodes / wall_s, (cpu_s_of([pid]) - own) / wall_s, cpu_s / episodes


def _archived(site: Site) -> int:
    with read_ledger(site) as connection:
        return progress_in(connection, site).jobs.get("archived", 0)


def _family(pid: int) -> Sequence[int]:
    """Returns a process and all its descendants."""
    children = [
        int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()
    ]
    return [pid, *(member for child in children for member in _family(child))]


def _view(host: str, site: Site, viewers: int, seconds: float) -> None:
    """Keeps a farm page open for each viewer; each viewer repeatedly loads the table and the first episode."""
    end_s = time.monotonic() + seconds

    episode = f"/episodes/{Dataset(site.place)[0].episode_id}"

    def visit(_number: int) -> None:
        while time.monotonic() < end_s:
            for path in ("/farm", "/episodes", episode, f"{episode}/frames/0.png"):
                ask_page(host, path)
            time.sleep(max(0.0, min(_VISIT_S, end_s - time.monotonic())))

    with ExitStack() as stack:
        for _ in range(viewers):
            open_tab(host, stack)
        with ThreadPoolExecutor(max(1, viewers)) as pool:
            list(pool.map(visit, range(viewers)))


def _attack(host: str, requests: int, seconds: float) -> None:
    """Sends hostile requests over the whole period while slow clients are connected."""
    begin_s = time.monotonic()
    with slow_clients(host, _SLOW_CLIENTS):
        flood(host, requests, seconds)
        time.sleep(max(0.0, begin_s + seconds - time.monotonic()))


@click.command()
@plan_argument(default="demo")
@workers_option("Number of simulation processes")
@number_option("SECONDS", "--seconds", 60.0, "Duration of each period, seconds.", least=1.0)
@count_option("--rounds", 5, "Number of periods of each kind.")
@count_option("--viewers", 5, "Number of viewers.", most=100)
@count_option("--requests", 10_000, "Number of hostile requests of a period with attackers.")
@json_option
def command(
    plan_name: str, workers: int | None, seconds: float, rounds: int, viewers: int, requests: int, as_json: bool
) -> None:
    """Measure what visitors of the web page cost a run.

    Starts a run of PLAN with `--record states` and its web page, in a temporary directory. Periods without visitors,
    with viewers and with attackers alternate. Attackers send hostile requests and keep slow connections open.
    """
    require_package("starlette", "this benchmark")
    report = bench_visited(plan_name, workers or os.cpu_count() or 1, seconds, rounds, viewers, requests)
    print_result(report, as_json, _show)


def _show(report: VisitedBench) -> None:
    rows = [
        (
            kind,
            _spread(cost.episodes_per_s),
            _spread(cost.coordinator_share, 100),
            _spread(cost.cpu_s_per_episode),
        )
        for kind, cost in report.costs.items()
    ]
    title = (
        f"Run of {report.plan}, {report.rounds} periods of {report.seconds:g} s each: {report.viewers} viewers, or "
        f"{report.requests} hostile requests"
    )
    print_table(title, ("visitors", "episodes/s", "coordinator, % of a core", "CPU s per episode"), rows)


def _spread(value: Spread, factor: float = 1.0) -> str:
    median, low, high = (factor * part for part in (value.median, value.low, value.high))
    return f"{median:.3g} ({low:.3g} to {high:.3g})"


if __name__ == "__main__":
    run(command)
