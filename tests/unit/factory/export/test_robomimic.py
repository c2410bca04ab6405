"""Exports for robomimic, read with h5py as robomimic reads them."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.origin import find_origin
from factory.export.registry import find_exporter
from factory.export.rlds import rlds_steps
from schemas.errors import UsageError, WorldError
from schemas.support.extras import install_command

FPS, SIDE = 20, 64


def exported(root: Path, out: Path) -> Path:
    options = find_exporter("robomimic").options(fps=FPS, image_px=SIDE)
    assert run_export(ExportOrder(root, out, "robomimic", options)).complete
    return out


@pytest.fixture(scope="module")
def out(varied: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(varied, tmp_path_factory.mktemp("robomimic") / "out")


@pytest.fixture
def file(out: Path) -> Iterator[h5py.File]:
    with h5py.File(out / "dataset.hdf5", swmr=True, libver="latest") as opened:  # as robomimic does
        yield opened


def test_a_demonstration_has_the_steps_of_its_episode(varied: Path, file: h5py.File) -> None:
    for episode in Dataset(varied):
        demo = file["data"][f"demo_{episode.summary.index}"]
        steps = list(rlds_steps(episode, FPS, SIDE))
        assert demo.attrs["num_samples"] == len(steps)
        for name in ("depth", "ids", "image", "state"):
            np.testing.assert_array_equal(demo["obs"][name], [step["observation"][name] for step in steps])
        for name, column in (
            ("action_tokens", "action_tokens"),
            ("camera_pose", "camera_pose"),
            ("commands", "action"),
        ):
            np.testing.assert_array_equal(demo[name], [step[column] for step in steps])
        assert demo["rewards"][:].tolist() == demo["dones"][:].tolist() == [0.0] * (len(steps) - 1) + [1.0]
        assert demo.attrs["language_instruction"] == episode.instruction
        assert json.loads(demo["instances"][()]) == [each.model_dump(mode="json") for each in episode.instances]


def test_actions_are_commands_in_the_range_of_the_policies(varied: Path, file: h5py.File) -> None:
    robot = Dataset(varied)[0].meta.job.robot
    for demo in file["data"].values():
        scale = demo.attrs["action_scale"]
        assert scale.tolist() == [robot.max_speed_mps, robot.max_yaw_rate_rps]
        assert np.abs(demo["actions"]).max() <= 1
        np.testing.assert_allclose(demo["actions"] * scale, demo["commands"], atol=1e-6)


def test_filter_keys_are_the_splits_and_the_names_of_robomimic(varied: Path, file: h5py.File) -> None:
    expected: dict[str, list[bytes]] = {}
    for episode in Dataset(varied):
        split, name = str(episode.summary.split), f"demo_{episode.summary.index}".encode()
        for mask in {split, {"train_id": "train", "val_id": "valid"}.get(split, split)}:
            expected.setdefault(mask, []).append(name)
    assert {"train", "train_id", "test_id"} <= expected.keys()
    assert {mask: demos[:].tolist() for mask, demos in file["mask"].items()} == expected
    assert file["data"].attrs["total"] == sum(demo.attrs["num_samples"] for demo in file["data"].values())
    assert json.loads(file["data"].attrs["env_args"])["type"] == 2


def test_two_exports_have_equal_bytes(varied: Path, out: Path, tmp_path: Path) -> None:
    again = exported(varied, tmp_path / "again")
    assert (again / "dataset.hdf5").read_bytes() == (out / "dataset.hdf5").read_bytes()


def test_the_origin_is_found_and_links_to_other_files_are_not_followed(out: Path, varied: Path, tmp_path: Path) -> None:
    assert find_origin(out, "3").states_digest == Dataset(varied)["ep_000003"].states_digest
    with h5py.File(tmp_path / "foreign.hdf5", "w") as file:
        file["data/demo_3"] = h5py.ExternalLink(str(out / "dataset.hdf5"), "/data/demo_3")
        file["data/demo_4"] = np.zeros(3)
    with pytest.raises(UsageError, match="states no origins"):
        find_origin(tmp_path / "foreign.hdf5", "3")
    (tmp_path / "damaged.hdf5").write_bytes(b"nothing" * 100)
    with pytest.raises(WorldError, match="cannot be read as an export"):
        find_origin(tmp_path / "damaged.hdf5", "3")


def test_an_origin_cannot_be_read_without_the_package(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(UsageError) as caught:
        find_origin(out, "1")
    assert install_command("robomimic") in str(caught.value)
