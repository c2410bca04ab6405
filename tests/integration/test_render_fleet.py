"""`factory coordinator start --states`: workers of any host render a states dataset."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from factory.dataset.reader import Dataset
from factory.verify.dataset import verify
from schemas.terms import Recording
from tests.builders.ports import free_endpoint

pytestmark = pytest.mark.gl
FACTORY = (sys.executable, "-m", "factory")


def test_workers_render_the_states_of_a_coordinator(recordings: dict[Recording, Path], tmp_path: Path) -> None:
    endpoint, out = free_endpoint(), tmp_path / "frames"
    start = ("coordinator", "start", "--states", str(recordings[Recording.STATES]), "--out", str(out))
    with subprocess.Popen([*FACTORY, *start, "--listen", endpoint], stdout=subprocess.PIPE) as coordinator:
        worker = (*FACTORY, "worker", "--cores", "1", "--connect", endpoint, "--renderer", "gl")
        spool = ("--spool", str(tmp_path / "spool"))
        done = subprocess.run([*worker, *spool], capture_output=True, text=True, check=False)
        coordinator.communicate()
    assert (coordinator.returncode, done.returncode) == (0, 0), done.stderr
    assert Dataset(out).digest == Dataset(recordings[Recording.FRAMES]).digest


def test_episodes_that_are_rendered_at_gateways_are_gathered(recordings: dict[Recording, Path], tmp_path: Path) -> None:
    core, door, out, gateway = free_endpoint(), free_endpoint(), tmp_path / "frames", tmp_path / "gw1"
    start = ("coordinator", "start", "--states", str(recordings[Recording.STATES]), "--out", str(out), "--listen", core)
    relay = ("gateway", "start", "--connect", core, "--out", str(gateway), "--listen", door, "--name", "gw1")
    worker = ("worker", "--cores", "1", "--connect", door, "--spool", str(tmp_path / "spool"), "--wait", "60")
    with subprocess.Popen([*FACTORY, *start]) as coordinator, subprocess.Popen([*FACTORY, *relay]) as between:
        done = subprocess.run([*FACTORY, *worker], capture_output=True, text=True, check=False)
        assert (done.returncode, coordinator.wait()) == (0, 0), done.stderr
        between.terminate()
    assert list((out / "episodes").iterdir()) == []
    subprocess.run([*FACTORY, "gather", str(out), str(gateway)], check=True, capture_output=True)
    report = verify(out, deep=True)
    assert (report.ok, report.digest) == (True, Dataset(recordings[Recording.FRAMES]).digest)


def test_a_plan_beside_states_is_refused(recordings: dict[Recording, Path], tmp_path: Path) -> None:
    start = (
        "coordinator",
        "start",
        "demo",
        "--states",
        str(recordings[Recording.STATES]),
        "--out",
        str(tmp_path / "o"),
    )
    done = subprocess.run([*FACTORY, *start], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "the plan is that of the dataset; omit PLAN demo" in done.stderr
    assert not (tmp_path / "o").exists()
