"""The web page of `factory run --http`: a browser watches a run; a benchmark measures the cost of visitors."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.acceptance.factory_cli import FactoryCli, Started, wait_for
from tests.builders.browser import chromium, why_no_chromium
from tests.builders.process_state import children_of

ROOT = Path(__file__).parents[2]
REASON = why_no_chromium()
pytestmark = [pytest.mark.slow, pytest.mark.skipif(bool(REASON), reason=REASON)]


def printed_url(run: Started) -> str:
    """Returns the URL of the page, with its token, once the command has printed it."""
    found: list[str] = []

    def is_printed() -> bool:
        assert run.poll() is None, run.communicate()
        found.extend(re.findall(r"web page and /metrics: (\S+)", (run.folder / "err").read_text()))
        return bool(found)

    wait_for(is_printed, 600)
    return found[0]


def start_benchmark(cache: Path, *words: object) -> subprocess.Popen[str]:
    """Starts the benchmark of visitors in a new interpreter, with the cache of the session."""
    return subprocess.Popen(
        [sys.executable, "-m", "tests.benchmarks.visited", *map(str, words)],
        cwd=ROOT,
        env={**os.environ, "MINIVLA_CACHE": str(cache)},
        stdout=subprocess.PIPE,
        text=True,
    )


def test_the_benchmark_reports_the_cost_of_each_kind_of_visitor(cache: Path, plan: Path):
    words = (plan, "--workers", 1, "--seconds", 2, "--rounds", 1, "--viewers", 2, "--requests", 100)
    with start_benchmark(cache, *words, "--json") as bench:
        costs = json.loads(bench.communicate(800)[0])["costs"]
    assert bench.returncode == 0
    assert list(costs) == ["none", "viewers", "attackers"]
    for cost in costs.values():
        assert cost["episodes_per_s"]["low"] > 0
        assert 0 < cost["coordinator_share"]["low"] < 1
        assert cost["cpu_s_per_episode"]["low"] > 0


def test_a_terminated_benchmark_ends_its_run(cache: Path):
    bench = start_benchmark(cache, "demo", "--workers", 1)
    runs: set[int] = set()

    def is_started() -> bool:
        assert bench.poll() is None, bench.communicate()
        runs.update(children_of(bench.pid))
        return bool(runs)

    wait_for(is_started)
    bench.terminate()
    assert (bench.communicate(120), bench.returncode)[1] == 130
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in runs))


def test_the_page_of_a_run_updates_itself_and_names_factory_serve_at_the_end(factory: FactoryCli, tmp_path):
    words = ("demo", "--scene", "office", "--episodes", 2, "--workers", 1, "--record", "states", "--gate", "skip")
    with chromium() as browser:
        page: Any = browser.new_page()
        page.set_default_timeout(600_000)
        run = factory.start("run", *words, "--out", tmp_path / "out", "--http", "127.0.0.1:0")
        page.goto(printed_url(run))
        assert re.fullmatch(r"[01] of 2 episodes archived", page.locator("#live .meter label").inner_text())
        assert page.request.get(f"{page.url}metrics").ok
        page.wait_for_selector("#live :text-is('2 of 2 episodes archived')")  # the page updates itself
        page.wait_for_selector("#offline:visible")
        assert f"factory serve {tmp_path / 'out'}" in page.locator("#offline").inner_text()
        assert page.locator(".tiles").inner_text().count("finished") == 1
    out, err = run.communicate(60)
    assert run.returncode == 0, err
    assert f"page:    factory serve {tmp_path / 'out'}" in out
