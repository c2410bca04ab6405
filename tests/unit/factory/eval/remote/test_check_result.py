"""Checks of results from other machines: a valid result, and every detected inconsistency."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import Any

import pytest

from factory.eval.driving.rollout import progresses, request_fields
from factory.eval.models.messages import EvalRequest, EvalSetup, EvalTask
from factory.eval.models.result import EpisodeResult, EvalEnd
from factory.eval.models.spec import EvalSettings
from factory.eval.policies.registry import PolicyNote
from factory.eval.remote.results import (
    ResultBundle,
    ResultValidator,
    read_result_bundle,
    result_digest,
    result_findings,
    write_result_bundle,
)
from schemas.encoding.container import ContainerWriter
from schemas.errors import InvalidBundle
from schemas.scene import Target
from tests.builders.bundle import job_for
from tests.builders.eval_results import spec_of

SETTINGS = EvalSettings()
STEPS, STEP_M = 121, 2.0 / 120
"""Two metres straight ahead towards a target 3 m away."""
TARGET = Target(
    target_id="chair_001",
    prim_path="/World/chair",
    instance_id=7,
    category="chair",
    colour="unknown",
    centroid_m=(3.0, 0.0, 0.4),
    size_m=(0.5, 0.5, 0.9),
)
TASK = EvalTask(
    number=1,
    policy="m:P",
    reference="m:P",
    request=EvalRequest(spec=spec_of(), spec_digest="d" * 64, instruction=spec_of().instruction),
    setup=EvalSetup(settings=SETTINGS),
)
NOTE = PolicyNote(policy="m:P", knows="camera and instruction", reads_instruction=True, renderer="x", software={})


def arrived(**changes: Any) -> EpisodeResult:
    """The result of a valid drive to the success circle."""
    rows = [*range(0, STEPS - 1, 6), STEPS - 1]
    values: dict[str, Any] = {
        **request_fields(TASK),
        "end": EvalEnd.SUCCESS,
        "detail": "",
        "success": True,
        "any_instance": True,
        "num_steps": STEPS,
        "spawn_dist_m": 3.0,
        "trajectory_length_m": 2.0,
        "final_ne_m": 1.0,
        "min_ne_m": 1.0,
        "spl": 1.0,
        "soft_spl": 1.0,
        **progresses(3.0, 1.0, 1.0, SETTINGS.task),
        "contact_steps": 0,
        "clipped_actions": 0,
        "act_ms": 1.0,
        "seconds": 2.0,
        "track": tuple((round(row * STEP_M, 3), 0.0, 0.0) for row in rows),
    }
    return EpisodeResult(**values | changes)


def findings(**changes: Any) -> list[str]:
    return result_findings(arrived(**changes), TASK, TARGET)


def test_an_honest_result_has_no_findings() -> None:
    assert findings() == []


def test_the_result_of_a_killed_process_may_lack_poses() -> None:
    lost = {"end": EvalEnd.POLICY_DIED, "success": False, "any_instance": False, "spl": 0.0, "soft_spl": 0.0}
    assert findings(**lost, track=((0.0, 0.0, 0.0),)) == []


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"spec_digest": "e" * 64}, "spec_digest is"),
        ({"policy": "expert"}, "policy is 'expert'"),
        ({"instruction": "Stay."}, "instruction is 'Stay.'"),
        ({"geodesic_m": 9.0}, "geodesic_m is 9.0"),
        ({"end": EvalEnd.TIMEOUT}, "success is True"),
        ({"any_instance": False}, "success is true, but any_instance is false"),
        ({"num_steps": 1001}, "more than the 1000"),
        ({"final_ne_m": 1.2}, "the radius is 1 m"),
        ({"contact_steps": 122}, "122 steps with contact"),
        ({"progress_final": 0.9}, "progress_final is 0.9"),
        ({"spl": 0.5}, "spl is 0.5"),
        ({"min_ne_m": 2.0}, "farther than start or end"),
        ({"track": ()}, "no track"),
        ({"track": ((0.5, 0.0, 0.0),) * 21}, "the track starts at"),
        ({"track": ((0.0, 0.0, math.pi),) * 21}, "the track starts at"),
        ({"track": ((0.0, 0.0, 0.0),) * 9}, "the track has 9 poses for 121 steps"),
        ({"track": ((0.0, 0.0, 0.0),) * 20 + ((2.0, 0.0, 0.0),)}, "between two poses"),
        ({"trajectory_length_m": 1.0}, "the track is 2.000 m long"),
        ({"track": ((0.0, 0.0, 0.0),) * 21}, "final_ne_m is 1.000 m, but the track gives 3.000 m"),
    ],
)
def test_every_inconsistent_value_is_named(changes: dict[str, Any], reason: str) -> None:
    assert any(reason in finding for finding in findings(**changes)), findings(**changes)


def bundle_of(result: EpisodeResult, note: PolicyNote = NOTE) -> bytes:
    out = io.BytesIO()
    write_result_bundle(ResultBundle(result=result, note=note), out)
    return out.getvalue()


def checked_result(tmp_path: Path, data: bytes) -> Any:
    path = tmp_path / "1.1.zip"
    path.write_bytes(data)
    return ResultValidator({1: TASK}).check(path, job_for(1), (TARGET,))


def test_a_valid_bundle_gets_a_receipt_that_does_not_depend_on_wall_clocks(tmp_path: Path) -> None:
    data = bundle_of(arrived())
    receipt = checked_result(tmp_path, data)
    assert (receipt.index, receipt.num_steps, receipt.file_bytes) == (1, STEPS, len(data))
    assert (
        receipt.content_digest == result_digest(arrived(act_ms=9.0, seconds=9.0)) != result_digest(arrived(detail="x"))
    )
    assert read_result_bundle(io.BytesIO(data)).result == arrived()


def test_invalid_bundles_and_bundles_of_other_tasks_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidBundle, match="not a readable zip"):
        checked_result(tmp_path, b"rubbish")
    with pytest.raises(InvalidBundle, match=r"spl is 0\.5"):
        checked_result(tmp_path, bundle_of(arrived(spl=0.5)))
    with pytest.raises(InvalidBundle, match="note of policy 'expert'"):
        checked_result(tmp_path, bundle_of(arrived(), NOTE.model_copy(update={"policy": "expert"})))
    for name, text in (("driven.json", b"{}"), ("driven.json", b"x" * (5 << 20)), ("other.json", b"{}")):
        out = io.BytesIO()
        with ContainerWriter(out) as container:
            container.add(name, text)
        with pytest.raises(InvalidBundle):
            checked_result(tmp_path, out.getvalue())
