"""`factory coordinator start --states`: workers on any host can render a states dataset."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.verify.dataset import verify
from schemas.terms import Recording
from tests.acceptance.factory_cli import Command, FactoryCli
from tests.builders.ports import free_endpoint

pytestmark = pytest.mark.gl


def test_workers_render_the_states_of_a_coordinator(
    factory: FactoryCli, recordings: dict[Recording, Path], tmp_path: Path
) -> None:
    endpoint, out = free_endpoint(), tmp_path / "frames"
    start = ("coordinator", "start", "--states", recordings[Recording.STATES], "--out", out)
    coordinator = factory.start(*start, "--listen", endpoint)
    worker = ("worker", "--cores", 1, "--connect", endpoint, "--renderer", "gl")
    factory(*worker, "--spool", tmp_path / "spool")
    assert coordinator.wait(60) == 0
    assert Dataset(out).digest == Dataset(recordings[Recording.FRAMES]).digest


@pytest.mark.slow
def test_episodes_that_are_rendered_at_gateways_are_gathered(
    factory: FactoryCli, command: Command, recordings: dict[Recording, Path], tmp_path: Path
) -> None:
    core, door, out, gateway = free_endpoint(), free_endpoint(), tmp_path / "frames", tmp_path / "gw1"
    start = ("coordinator", "start", "--states", recordings[Recording.STATES], "--out", out, "--listen", core)
    relay = ("gateway", "start", "--connect", core, "--out", gateway, "--listen", door, "--name", "gw1")
    coordinator, between = factory.start(*start), factory.start(*relay)
    factory("worker", "--cores", 1, "--connect", door, "--spool", tmp_path / "spool", "--connect-timeout", 60)
    assert coordinator.wait(60) == 0
    between.terminate()
    between.wait(60)
    assert list((out / "episodes").iterdir()) == []
    command("gather", out, gateway)
    report = verify(out, deep=True)
    assert (report.ok, report.digest) == (True, Dataset(recordings[Recording.FRAMES]).digest)


def test_a_plan_together_with_states_is_refused(
    command: Command, recordings: dict[Recording, Path], tmp_path: Path
) -> None:
    start = ("coordinator", "start", "demo", "--states", recordings[Recording.STATES], "--out", tmp_path / "o")
    assert "the plan is that of the dataset; omit PLAN demo" in command(*start, expect=2).stderr
    assert not (tmp_path / "o").exists()
