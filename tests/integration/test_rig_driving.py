"""Rigs during a drive: the Gymnasium environment and `factory eval --rig`."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.eval.driving.live_view import live_arrays, shows_recorded_camera
from factory.eval.models.messages import EvalSetup
from factory.eval.models.result import EvalEnd, Variant
from factory.eval.models.spec import SpecSet
from factory.eval.policies.registry import require_inputs
from factory.eval.process.local_campaign import run_campaign
from factory.eval.results.publish import RESULTS_FILE, publish
from factory.eval.results.store import EvalManifest, Store
from factory.eval.specs.campaign import Campaign
from factory.eval.specs.from_dataset import specs_of_dataset
from factory.gym.env import MiniVLANavEnv
from schemas.config import CameraConfig
from schemas.errors import UsageError
from schemas.rig import Rig
from schemas.rig.rig_file import paper_rig
from schemas.terms import Split
from schemas.view import ViewSettings
from tests.builders.policies import Looks, Scans
from tests.builders.rigs import small_rig, write_rig
from workers.sensors.observation import arrays_in

SCANS, LOOKS = (f"tests.builders.policies:{name}" for name in ("Scans", "Looks"))


@pytest.fixture(scope="module")
def specs(drives: Dataset) -> SpecSet:
    found = specs_of_dataset(drives, [Split.TEST_ID]).only(None, 1)
    task = found.settings.task.model_copy(update={"max_steps": 4})
    return found.model_copy(update={"settings": found.settings.model_copy(update={"task": task})})


def test_measurements_during_a_drive_equal_those_of_readers_of_its_recording(drives: Dataset) -> None:
    rig = small_rig(has_noise=False)
    episode = Dataset(drives.root, rig=rig)["ep_000003"]
    motion, hz = episode.motion(), episode.meta.job.task.control_hz
    env = MiniVLANavEnv(drives.root, split=str(episode.summary.split), rig=rig)
    seen, _ = env.reset(options={"episode": "ep_000003"})
    for t, action in enumerate(episode.actions[:13]):
        assert env.observation_space.contains(seen)
        for sensor in rig.sensors:
            stride = sensor.stride(hz)
            for name in live_arrays(sensor):
                if sensor.name in motion:
                    expected = arrays_in(motion[sensor.name])[name][t // stride]
                else:
                    expected = arrays_in(episode.observe(t - t % stride, [sensor.name])[sensor.name])[name]
                assert np.array_equal(seen[f"{sensor.name}/{name}"], expected)
        seen, *_ = env.step(action)
    env.close()
    assert not any(key.endswith("/ids") or key in {"rgb", "depth"} for key in seen)


def test_an_environment_refuses_a_rig_with_optical_flow(drives: Dataset, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"camera 'front' has the output 'flow'.*: remove 'flow' from outputs"):
        MiniVLANavEnv(drives.root, rig=write_rig(tmp_path))


def open_store(root: Path, campaign: Campaign) -> Store:
    manifest = EvalManifest(
        run=campaign.specs.run,
        specs_digest=campaign.specs.digest,
        with_pose=False,
        act_timeout_s=10.0,
        view=campaign.setup.view,
    )
    return Store(root, campaign.specs, manifest)


def campaign_of(drives: Dataset, specs: SpecSet, policy: str, rig: Rig | None) -> Campaign:
    setup = EvalSetup(settings=specs.settings, view=ViewSettings(rig=rig))
    assert isinstance(drives.root, Path)
    return Campaign(specs, drives.root, (policy,), (Variant.ORIGINAL,), setup)


def test_a_policy_gets_the_sensors_of_the_rig_and_the_results_record_it(
    drives: Dataset, specs: SpecSet, tmp_path: Path
) -> None:
    rig = small_rig()
    campaign = campaign_of(drives, specs, SCANS, rig)
    with open_store(tmp_path, campaign) as store:
        assert run_campaign(campaign, store, threading.Event(), lambda _pace: None)
        assert [(row.end, row.detail) for row in store.results(SCANS) if row.end is not EvalEnd.TIMEOUT] == []
        publish(campaign, store, 0)
    results = json.loads((tmp_path / RESULTS_FILE).read_text())
    assert ViewSettings.model_validate(results["view"]) == campaign.setup.view
    assert f"view of the policies: rig small ({rig.digest[:12]})" in results["remarks"]
    with pytest.raises(UsageError, match=r"another evaluation \(view rig small \(.*\), now the recorded camera\)"):
        open_store(tmp_path, campaign_of(drives, specs, SCANS, None))


def test_a_policy_is_refused_before_an_episode_if_the_rig_lacks_its_inputs(
    drives: Dataset, specs: SpecSet, tmp_path: Path
) -> None:
    campaign = campaign_of(drives, specs, LOOKS, small_rig())
    with (
        open_store(tmp_path, campaign) as store,
        pytest.raises(UsageError, match="needs rgb, depth, which rig 'small'"),
    ):
        run_campaign(campaign, store, threading.Event(), lambda _pace: None)


def test_inputs_are_those_of_the_rig_or_of_the_recorded_camera() -> None:
    camera = CameraConfig()
    require_inputs("looks", Looks(), None, camera)
    require_inputs("looks", Looks(), paper_rig(), camera)
    require_inputs("scans", Scans(), small_rig(), camera)
    with pytest.raises(
        UsageError, match=r"scan/ranges, which the recorded camera does not provide.*give --rig RIG with"
    ):
        require_inputs("scans", Scans(), None, camera)
    assert not shows_recorded_camera(paper_rig(), camera.model_copy(update={"fov_deg": 60.0}))
