"""Reads exports in the format `rlds` with TFDS and compares every step with the paper's tree.

Runs in an environment with `tensorflow`, `tensorflow-datasets` and Pillow; does not import this project. Exits with
code 1 at the first failed check.

    python tests/readers/rlds_reader.py PAPER EXPORT [EXPORT ...]

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `--to rlds`, at any rate and size.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import tensorflow_datasets as tfds
from paper_tree import Paper, mean_commands, shrunk
from result import named, print_row

README = Path(__file__).parents[2] / "docs/formats/rlds/README.md"
RECORDED_HZ = 60
HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
"""Distance of the centre of the first pixel from the corner of the image, as a change of a camera matrix."""
LOADER_SPLITS = {"train_id": "train", "val_id": "val"}


def main() -> None:
    paper, exports = Paper(Path(sys.argv[1])), [Path(word) for word in sys.argv[2:]]
    for export in exports:
        print_row(export, named("tensorflow-datasets", "tensorflow"), check(paper, export))


def check(paper: Paper, export: Path) -> str:
    """Compares every step of every episode; returns the result."""
    options = json.loads((export / "export.json").read_text())["options"]
    (version,) = (export / "minivla_nav").iterdir()
    assert str(version.relative_to(export)) in README.read_text(encoding="utf-8"), "README.md names another version"
    builder = tfds.builder_from_directory(version)
    check_description(builder, version)
    seen: dict[str, int] = {}
    for split in builder.info.splits:
        for episode in builder.as_dataset(split=split):
            about = tfds.as_numpy(episode["episode_metadata"])
            name, steps = about["episode_id"].decode(), list(tfds.as_numpy(episode["steps"]))
            stride = RECORDED_HZ // (options["fps"] or RECORDED_HZ)
            recorded = paper.meta(name)["job"]["split"]
            assert split == (LOADER_SPLITS.get(recorded, recorded) if options["loader_splits"] else recorded)
            seen[name] = check_episode(paper, name, stride, steps)
            check_metadata(paper, name, about)
            check_camera(paper, name, stride, steps, about)
        assert builder.info.splits[split].num_examples == sum(1 for _ in builder.as_dataset(split=split))
        check_registration(builder.as_dataset(split=split))
    assert seen.keys() == {path.name for path in paper.episodes.iterdir()}
    side = options["image_px"]
    return f"{sum(seen.values())} steps of {len(seen)} episodes at {side} px, equal to the paper's tree"


def check_description(builder: Any, version: Path) -> None:
    """Compares `features.json` and `dataset_info.json` with those that TFDS itself writes for the same features."""
    with tempfile.TemporaryDirectory() as place:
        builder.info.features.save_config(place)
        own = json.loads((Path(place) / "features.json").read_text())
    assert own == json.loads((version / "features.json").read_text()), "TFDS writes other features"
    own = json.loads(builder.info.as_json)
    ours = json.loads((version / "dataset_info.json").read_text())
    assert ours == {name: own[name] for name in ours}, "TFDS writes another description"
    loaded = tfds.load("minivla_nav", data_dir=version.parents[1])
    assert loaded.keys() == builder.info.splits.keys()


def check_registration(episodes: Any) -> None:
    """Applies the transforms for OpenVLA and Octo to an episode; compares values and the names in the README."""
    sys.path.insert(0, str(README.parent))
    import registration

    steps = next(iter(episodes))["steps"]
    (whole,) = steps.batch(len(list(steps)))
    action, state = (value.numpy() for value in (whole["action"], whole["observation"]["state"]))
    arm = registration.openvla_transform({**whole, "observation": dict(whole["observation"])})
    expected = np.zeros((len(action), 7), np.float32)
    expected[:, [0, 5]] = action
    np.testing.assert_array_equal(arm["action"], expected)
    parts = [arm["observation"][name].numpy() for name in registration.OPENVLA_CONFIG["state_obs_keys"] if name]
    assert [part.shape[1] for part in parts] == [6, 1]
    np.testing.assert_array_equal(parts[0][:, [0, 1, 5]], state[:, :3])
    assert arm["observation"][registration.OPENVLA_CONFIG["image_obs_keys"]["primary"]].dtype == np.uint8
    two = registration.octo_transform({**whole, "observation": dict(whole["observation"])})
    np.testing.assert_array_equal(two["action"], action)
    np.testing.assert_array_equal(two["observation"][registration.OCTO_KWARGS["proprio_obs_key"]], state)
    assert two[registration.OCTO_KWARGS["language_key"]].dtype == "string"
    text = README.read_text(encoding="utf-8")
    for name, value in (registration.OPENVLA_CONFIG | registration.OCTO_KWARGS).items():
        if name != "image_obs_keys":
            assert f'"{name}": {json.dumps(value).replace("null", "None")}' in text, f"README.md has another {name}"


def check_episode(paper: Paper, name: str, stride: int, steps: list[dict[str, Any]]) -> int:
    """Compares every step of an episode; returns the number of steps."""
    job, poses = paper.meta(name)["job"], paper.array(name, "poses")
    actions = mean_commands(paper.array(name, "actions_continuous"), stride)
    assert len(steps) == len(actions)
    for number, (step, action) in enumerate(zip(steps, actions, strict=True)):
        seen, t, is_last = step["observation"], number * stride, number == len(steps) - 1
        side = len(seen["image"])
        np.testing.assert_array_equal(seen["image"], shrunk(paper.rgb(name, t), side))
        np.testing.assert_array_equal(seen["depth"][:, :, 0], shrunk(paper.depth(name, t), side))
        np.testing.assert_array_equal(seen["ids"][:, :, 0], shrunk(paper.ids(name, t), side))
        np.testing.assert_allclose(np.hypot(*seen["state"][:2]), np.hypot(*(poses[t, :2] - poses[0, :2])), atol=1e-4)
        np.testing.assert_allclose(step["action"], action, atol=1e-6)
        grid = (np.linspace(0, 1, 7)[step["action_tokens"][0]], np.linspace(-1.5, 1.5, 7)[step["action_tokens"][1]])
        assert np.all(np.abs(action - grid) <= (1 / 12 + 1e-6, 1 / 4 + 1e-6))
        assert (step["is_first"], step["is_last"], step["is_terminal"]) == (number == 0, is_last, is_last)
        assert (step["reward"], step["discount"]) == (float(is_last), 1.0)
        assert step["language_instruction"].decode() == job["instruction"]
    return len(steps)


def check_metadata(paper: Paper, name: str, about: dict[str, Any]) -> None:
    """Compares the target and the names of the ids with `meta.json`."""
    meta = paper.meta(name)
    assert json.loads(about["instances"]) == meta["instances"]
    assert about["target_instance_id"] == meta["target_instance_id"]
    np.testing.assert_allclose(about["target_centroid_m"], meta["target_centroid_m"], atol=1e-5)
    job = meta["job"]
    texts = {"split": job["split"], "scene": job["scene"], "target_id": job["target_id"]}
    assert {key: about[key].decode() for key in texts} == texts
    assert json.loads(about["origin"])["episode"] == name


def check_camera(paper: Paper, name: str, stride: int, steps: list[dict[str, Any]], about: dict[str, Any]) -> None:
    """Compares matrix and poses of the camera with the description of the camera and the poses of the paper's tree."""
    (camera,) = json.loads((paper.root / "rig.json").read_text())["sensors"]
    scale = len(steps[0]["observation"]["image"]) / camera["width"]
    scaled = (np.reshape(camera["camera_matrix"], (3, 3)) + HALF) * [[scale], [scale], [1]] - HALF
    np.testing.assert_allclose(about["camera_matrix"], scaled, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(about["camera_in_base"][:3], camera["pose"][:3], atol=1e-6)
    poses = paper.array(name, "poses")[::stride]
    offset = np.linalg.norm([step["camera_pose"][:3] for step in steps] - poses[:, :3], axis=1)
    np.testing.assert_allclose(offset, np.linalg.norm(camera["pose"][:3]), atol=1e-5)


if __name__ == "__main__":
    main()
