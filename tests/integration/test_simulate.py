"""The real simulation process: its reports, and its exit when its supervisor ends."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.bundle import BundleReader
from schemas.job import Job
from schemas.scene import encode_scene
from schemas.terms import FailReason
from tests.builders.bundle import job_for
from tests.builders.scene import box_room
from workers.client.settings import WorkerSettings
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind, to_line
from workers.process.simulation import ProcessEnd, Simulation

COMMAND = WorkerSettings(connect=(), renderer="tiny").simulation_command
FAST_COMMAND = WorkerSettings(connect=(), renderer="gl").simulation_command
PARENT = """
import sys
from pathlib import Path
from workers.process.messages import SimulationOrder
from workers.process.simulation import Simulation
order, told, *command = sys.argv[1:]
simulation = Simulation(command, 600.0)
simulation.start()
print(simulation.receive(60.0).kind)
simulation.order(SimulationOrder.model_validate_json(Path(order).read_bytes()))
print(simulation.receive(60.0).kind)
Path(told).write_text(str(simulation.pid))
while simulation.receive(60.0):
    pass
"""


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("room") / "room.scene"
    path.write_bytes(encode_scene(box_room()))
    return path


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    handle = Simulation(COMMAND, 120.0)
    handle.start()
    yield handle
    handle.kill()


def job_in(room: Path, **changes: object) -> Job:
    data = room.read_bytes()
    values = {
        "scene": "box_room",
        "scene_sha256": hashlib.sha256(data).hexdigest(),
        "scene_bytes": len(data),
        "category": "crate",
        "target_id": box_room().info.targets[0].target_id,
    }
    return job_for(**values | changes)


def order_in(room: Path, folder: Path, **changes: object) -> SimulationOrder:
    return SimulationOrder(job=job_in(room, **changes), scene_path=room, bundle_path=folder / "1.1.zip", sid="host-1")


def wait_for_report(simulation: Simulation, *kinds: SimulationReportKind) -> SimulationReport:
    """Waits for a report of one of the kinds and returns it; ignores reports of other kinds."""
    while True:
        report = simulation.receive(0.2)
        assert not isinstance(report, ProcessEnd), report
        if report is not None and report.kind in kinds:
            return report


OUTCOMES = (SimulationReportKind.SUCCESS, SimulationReportKind.FAILURE)


@pytest.mark.gl
def test_the_bundle_matches_its_report(room, tmp_path):
    simulation = Simulation(FAST_COMMAND, 120.0)
    simulation.start()
    try:
        simulation.order(order_in(room, tmp_path))
        report = wait_for_report(simulation, *OUTCOMES)
    finally:
        simulation.kill()
    assert report.kind is SimulationReportKind.SUCCESS, report
    data = (tmp_path / "1.1.zip").read_bytes()
    assert (hashlib.sha256(data).hexdigest(), len(data)) == (report.sha256, report.size)
    with (tmp_path / "1.1.zip").open("rb") as file, BundleReader(file) as bundle:
        assert bundle.length == report.step
        assert bundle.meta.provenance.worker == "host-1"
    assert [path.name for path in tmp_path.iterdir()] == ["1.1.zip"]


def test_a_process_survives_an_unusable_scene(room, tmp_path, simulation):
    wait_for_report(simulation, SimulationReportKind.READY)
    pid = simulation.pid
    (tmp_path / "bad.scene").write_bytes(b"no scene")
    for path in (tmp_path / "bad.scene", tmp_path / "missing.scene"):
        simulation.order(order_in(room, tmp_path).model_copy(update={"scene_path": path}))
        report = wait_for_report(simulation, *OUTCOMES)
        assert (report.kind, report.reason) == (SimulationReportKind.FAILURE, FailReason.CRASH)
    assert simulation.pid == pid
    assert not list(tmp_path.glob("*.part"))


def test_unforeseen_error_is_reported_and_ends_the_process(room, tmp_path, simulation):
    wait_for_report(simulation, SimulationReportKind.READY)
    simulation.order(order_in(room, tmp_path, template_id="train_01", target_id="nothing_999"))
    report = wait_for_report(simulation, *OUTCOMES)
    assert report.reason is FailReason.CRASH
    assert "nothing_999" in report.detail
    end = None
    while end is None:
        end = simulation.receive(0.2)
    assert isinstance(end, ProcessEnd)
    assert end.detail.startswith("exit status 3")


@pytest.mark.parametrize("said", [b"", b'{"job": {"run'], ids=["nothing", "half an order"])
def test_idle_simulation_ends_when_its_orders_end(said):
    process = subprocess.Popen(COMMAND, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    process.communicate(said, timeout=60)
    assert process.returncode == 0


def test_busy_simulation_dies_with_its_killed_supervisor(room, tmp_path):
    order, told = tmp_path / "order.json", tmp_path / "pid"
    order.write_bytes(to_line(order_in(room, tmp_path)))
    parent = subprocess.Popen([sys.executable, "-c", PARENT, str(order), str(told), *COMMAND])
    try:
        deadline = time.monotonic() + 60
        while not (told.is_file() and told.read_text()):
            assert time.monotonic() < deadline
            assert parent.poll() is None
            time.sleep(0.05)
        pid = int(told.read_text())
        assert Path(f"/proc/{pid}").exists()
    finally:
        os.kill(parent.pid, signal.SIGKILL)
        parent.wait()
    while Path(f"/proc/{pid}").exists():
        assert time.monotonic() < deadline, "the simulation outlives its supervisor"
        time.sleep(0.05)
