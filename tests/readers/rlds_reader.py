"""Builds the RLDS recipe with TFDS, reads it back and compares every step with the paper's tree.

Runs in an environment with `tensorflow`, `tensorflow-datasets` and this project (the builder needs it; the reader does
not import it). Exits with code 1 at the first failed check.

    python tests/readers/rlds_reader.py DATASET PAPER BUILT

PAPER: DATASET as `factory export --to paper`. BUILT: a folder that does not exist, for the built dataset.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import tensorflow_datasets as tfds
from paper_tree import Paper, mean_commands
from result import named, print_row

RECIPE = Path(__file__).parents[2] / "docs/formats/rlds/build.py"
README = RECIPE.with_name("README.md")
RECORDED_HZ, FPS, IMAGE_PX = 60, 10, 640


def main() -> None:
    dataset, tree, built = map(Path, sys.argv[1:])
    paper = Paper(tree)
    values = {"MINIVLA_DATASET": str(dataset.resolve()), "MINIVLA_FPS": str(FPS), "MINIVLA_IMAGE_PX": str(IMAGE_PX)}
    subprocess.run([sys.executable, str(RECIPE), str(built)], env={**os.environ, **values}, check=True)
    (version,) = (built / "minivla_nav").iterdir()
    assert str(version.relative_to(built)) in README.read_text(encoding="utf-8"), "the recipe names another version"
    builder = tfds.builder_from_directory(version)
    seen: dict[str, int] = {}
    for split in builder.info.splits:
        for episode in builder.as_dataset(split=split):
            name = episode["episode_metadata"]["episode_id"].numpy().decode()
            steps = list(tfds.as_numpy(episode["steps"]))
            seen[name] = check_episode(paper, name, split, steps)
            check_camera(paper, name, steps, tfds.as_numpy(episode["episode_metadata"]))
        check_registration(builder.as_dataset(split=split))
    assert seen.keys() == {path.name for path in paper.episodes.iterdir()}
    result = (
        f"{sum(seen.values())} steps of {len(seen)} episodes in {len(builder.info.splits)} splits, built and read back"
    )
    print_row(built, named("tensorflow-datasets", "tensorflow"), f"{result}, equal to the paper's tree")


def check_registration(episodes: Any) -> None:
    """Applies the transforms for OpenVLA and Octo to an episode; compares values and the names in the README."""
    sys.path.insert(0, str(RECIPE.parent))
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


def check_episode(paper: Paper, name: str, split: str, steps: list[dict[str, Any]]) -> int:
    """Compares every step of an episode; returns the number of steps."""
    job, stride = paper.meta(name)["job"], RECORDED_HZ // FPS
    assert split == job["split"]
    actions = mean_commands(paper.array(name, "actions_continuous"), stride)
    assert len(steps) == len(actions)
    for number, (step, action) in enumerate(zip(steps, actions, strict=True)):
        seen, t, is_last = step["observation"], number * stride, number == len(steps) - 1
        np.testing.assert_array_equal(seen["image"], paper.rgb(name, t))
        np.testing.assert_array_equal(seen["depth"][:, :, 0], paper.depth(name, t))
        way = np.hypot(*(paper.array(name, "poses")[t, :2] - paper.array(name, "poses")[0, :2]))
        np.testing.assert_allclose(np.hypot(*seen["state"][:2]), way, atol=1e-4)
        np.testing.assert_allclose(step["action"], action, atol=1e-6)
        assert (step["is_first"], step["is_last"], step["is_terminal"]) == (number == 0, is_last, is_last)
        assert (step["reward"], step["discount"]) == (float(is_last), 1.0)
        assert step["language_instruction"].decode() == job["instruction"]
    return len(steps)


def check_camera(paper: Paper, name: str, steps: list[dict[str, Any]], about: dict[str, Any]) -> None:
    """Compares matrix and poses of the camera with the description of the camera and the poses of the paper's tree."""
    (camera,) = json.loads((paper.root / "rig.json").read_text())["sensors"]
    np.testing.assert_allclose(about["camera_matrix"].ravel(), camera["camera_matrix"], rtol=1e-6)
    np.testing.assert_allclose(about["camera_in_base"][:3], camera["pose"][:3], atol=1e-6)
    poses = paper.array(name, "poses")[:: RECORDED_HZ // FPS]
    offset = np.linalg.norm([step["camera_pose"][:3] for step in steps] - poses[:, :3], axis=1)
    np.testing.assert_allclose(offset, np.linalg.norm(camera["pose"][:3]), atol=1e-5)


if __name__ == "__main__":
    main()
