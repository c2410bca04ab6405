"""Reads an export in the format `robomimic` with robomimic's own `SequenceDataset` and file utilities.

Runs in an environment with `robomimic`, PyTorch and Pillow; does not import this project. Exits with code 1 at the
first failed check.

    python tests/readers/robomimic_reader.py PAPER EXPORT [EXPORT ...]

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `--to robomimic`, at any rate and size.
"""

import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from paper_tree import Paper, mean_commands, shrunk
from result import named, print_row
from robomimic.utils import file_utils, obs_utils
from robomimic.utils.dataset import SequenceDataset

RECORDED_HZ = 60
OBSERVATIONS = ("depth", "ids", "image", "state")
COLUMNS = ("actions", "commands", "action_tokens", "rewards", "dones", "camera_pose")


def main() -> None:
    paper, exports = Paper(Path(sys.argv[1])), [Path(word) for word in sys.argv[2:]]
    obs_utils.initialize_obs_utils_with_obs_specs({"obs": {"low_dim": ["state"], "rgb": ["image"], "depth": ["depth"]}})
    for export in exports:
        print_row(export, f"{named('robomimic', 'h5py')}: SequenceDataset", check(paper, export))


def check(paper: Paper, export: Path) -> str:
    """Compares every step of every episode; returns the result."""
    file = export / "dataset.hdf5"
    options = json.loads((export / "export.json").read_text())["options"]
    stride = RECORDED_HZ // (options["fps"] or RECORDED_HZ)
    assert file_utils.get_env_metadata_from_dataset(str(file))["env_kwargs"] == {}
    shapes = file_utils.get_shape_metadata_from_dataset(str(file), all_obs_keys=["image", "state"])
    assert (shapes["ac_dim"], shapes["use_images"]) == (2, True)
    assert shapes["all_shapes"]["image"] == [3, options["image_px"], options["image_px"]]
    whole = opened(file, None)
    steps = 0
    for index, demo in enumerate(whole.demos):
        steps += check_episode(paper, file, whole.get_trajectory_at_index(index), demo, stride)
    assert steps == len(whole)
    check_filter_keys(paper, file, whole.demos)
    check_sequences(file)
    return f"{steps} steps of {len(whole.demos)} episodes and the filter keys, equal to the paper's tree"


def opened(file: Path, filter_key: str | None, **options: Any) -> SequenceDataset:
    values = {"filter_by_attribute": filter_key, "load_next_obs": False, **options}
    return SequenceDataset(str(file), obs_keys=OBSERVATIONS, dataset_keys=COLUMNS, **values)


def check_episode(paper: Paper, file: Path, found: dict[str, Any], demo: str, stride: int) -> int:
    name = f"ep_{int(demo.removeprefix('demo_')):06d}"
    job, poses = paper.meta(name)["job"], paper.array(name, "poses")
    commands = mean_commands(paper.array(name, "actions_continuous"), stride)
    seen, side = found["obs"], found["obs"]["image"].shape[1]
    for number, t in enumerate(range(0, len(poses), stride)):
        np.testing.assert_array_equal(seen["image"][number], shrunk(paper.rgb(name, t), side))
        np.testing.assert_array_equal(seen["depth"][number, :, :, 0], shrunk(paper.depth(name, t), side))
        np.testing.assert_array_equal(seen["ids"][number, :, :, 0], shrunk(paper.ids(name, t), side))
        way = np.hypot(*(poses[t, :2] - poses[0, :2]))
        np.testing.assert_allclose(np.hypot(*seen["state"][number, :2]), way, atol=1e-4)
    assert len(found["actions"]) == len(commands) == number + 1
    robot = job["robot"]
    scale = (robot["max_speed_mps"], robot["max_yaw_rate_rps"])
    np.testing.assert_allclose(found["commands"], commands, atol=1e-6)
    np.testing.assert_allclose(found["actions"] * scale, commands, atol=1e-6)
    assert np.abs(found["actions"]).max() <= 1
    expected = (np.arange(len(commands)) == number).astype(float)
    np.testing.assert_array_equal(found["rewards"], expected)
    np.testing.assert_array_equal(found["dones"], expected)
    camera = json.loads((paper.root / "rig.json").read_text())["sensors"][0]
    offset = np.linalg.norm(found["camera_pose"][:, :3] - poses[::stride, :3], axis=1)
    np.testing.assert_allclose(offset, np.linalg.norm(camera["pose"][:3]), atol=1e-5)
    with h5py.File(file) as opened_file:
        about = opened_file["data"][demo]
        assert about.attrs["language_instruction"] == job["instruction"]
        instances = json.loads(about["instances"][()])
    assert instances == paper.meta(name)["instances"]
    return len(commands)


def check_filter_keys(paper: Paper, file: Path, demos: list[str]) -> None:
    """Compares each filter key with the splits of the paper's tree; `train` and `valid` are `train_id` and `val_id`."""
    splits: dict[str, list[str]] = {}
    for demo in demos:
        split = paper.meta(f"ep_{int(demo.removeprefix('demo_')):06d}")["job"]["split"]
        for key in {split, {"train_id": "train", "val_id": "valid"}.get(split, split)}:
            splits.setdefault(key, []).append(demo)
    with h5py.File(file) as opened_file:
        assert set(opened_file["mask"]) == splits.keys()
        total = opened_file["data"].attrs["total"]
    for key, members in splits.items():
        assert file_utils.get_demos_for_filter_key(str(file), key) == members
        assert opened(file, key).demos == members
    assert total == len(opened(file, None))


def check_sequences(file: Path) -> None:
    """Reads sequences with stacked frames, from the file and from the caches."""
    for mode in (None, "low_dim"):
        data = opened(file, "train", frame_stack=2, seq_length=3, hdf5_cache_mode=mode)
        first = data[1]
        assert first["obs"]["image"].shape[:1] == first["actions"].shape[:1] == (4,)
        np.testing.assert_array_equal(first["obs"]["state"][0], data[0]["obs"]["state"][1])


if __name__ == "__main__":
    main()
