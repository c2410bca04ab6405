"""Evaluation tasks that the evaluation process of a worker refuses."""

from __future__ import annotations

import subprocess
from pathlib import Path

from factory.eval.models.messages import DriverOrder, EvalReport, EvalReportKind, EvalRequest, EvalSetup, EvalTask
from factory.eval.models.spec import EvalSettings
from factory.eval.process.driver_process import DriverProcess
from schemas.support.child import python_module
from schemas.terms import FailReason
from tests.builders.bundle import job_for
from tests.builders.eval_results import spec_of
from workers.process.messages import SimulationOrder, SimulationReport, SimulationReportKind, read_report, to_line


def reports_on(policy: str, tmp_path: Path) -> list[SimulationReport]:
    """Runs an evaluation process with one task and returns its reports."""
    request = EvalRequest(spec=spec_of(), spec_digest="d" * 64, instruction="")
    task = EvalTask(
        number=1, policy=policy, reference=policy, request=request, setup=EvalSetup(settings=EvalSettings())
    )
    order = SimulationOrder(
        job=job_for(1),
        scene_path=tmp_path / "no.scene",
        bundle_path=tmp_path / "1.1.zip",
        sid="host-1",
        eval_task=task.model_dump_json(),
    )
    command = python_module("factory.eval.remote.eval_worker")
    found: list[SimulationReport] = []
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(to_line(order))
        process.stdin.flush()
        for line in process.stdout:
            report = read_report(line)
            assert report is not None, line
            found.append(report)
            if report.kind is SimulationReportKind.FAILURE:
                process.stdin.close()  # the process ends when its worker closes stdin
    assert process.returncode == 0
    return found


def test_classes_are_imported_only_where_the_worker_allows_it(tmp_path: Path) -> None:
    ready, refused = reports_on("tests.builders.policies:Tokens", tmp_path)
    assert ready.kind is SimulationReportKind.READY
    assert refused.reason is FailReason.CRASH
    assert "--import-policies" in refused.detail


def test_a_missing_scene_gives_no_result(tmp_path: Path) -> None:
    last = reports_on("stop", tmp_path)[-1]
    assert last.reason is FailReason.CRASH
    assert "no.scene" in last.detail


def test_a_driver_process_is_replaced_when_the_settings_change(tmp_path: Path) -> None:
    package = tmp_path / "damaged.scene"
    package.write_bytes(b"damaged")
    driver = DriverProcess()

    def process_for(act_timeout_s: float) -> int | None:
        setup = EvalSetup(settings=EvalSettings(), act_timeout_s=act_timeout_s)
        request = EvalRequest(spec=spec_of(), spec_digest="d" * 64, instruction="")
        task = EvalTask(number=1, policy="stop", reference="stop", request=request, setup=setup)
        driver.send(DriverOrder(task=task, package=package))
        while (heard := driver.poll(60.0)) is None:
            pass
        assert isinstance(heard, EvalReport)
        assert (heard.kind, heard.number) == (EvalReportKind.REFUSED, task.number)
        assert {name: report.detail for name, report in driver.made.items()} == {"stop": "nothing"}
        return driver.pid

    try:
        first, again, other = process_for(1.0), process_for(1.0), process_for(2.0)
    finally:
        driver.kill()
    assert first == again != other
