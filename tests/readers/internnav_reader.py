"""Opens exports with the loaders of InternNav: NavDP's dataset, and the annotations of InternVLA-N1.

Does not import this project. Exits with code 1 at the first failed check.

    python tests/readers/internnav_reader.py NAVDP INTERNNAV CHECKOUT

NAVDP, INTERNNAV: the same episodes as `factory export --to navdp` and `--to internnav`. CHECKOUT:
InternRobotics/InternNav (not on a package index); its NavDP loader needs torch, open3d, opencv-python-headless,
jsonlines, scipy and pandas. Of the module of InternVLA-N1, which needs the tokenizers of a model, only the functions
that read data are run.
"""

import ast
import importlib.util
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from result import named, print_row
from scipy.interpolate import CubicSpline

DATASETS = "internnav/dataset"
FUNCTIONS = (
    "read_jsonl", "get_annotations_from_lerobot_data", "get_trajectory_relative_to_frame",
    "interpolate_and_resample_trajectory", "smooth_and_resample_trajectory", "xy_to_delta_xyt",
)  # fmt: skip
LEFT, RIGHT = 2, 3


def main() -> None:
    navdp, internnav, checkout = map(Path, sys.argv[1:4])
    print_row(navdp, f"NavDP_Base_Datset, {named('torch', 'open3d')}", check_navdp(navdp, checkout))
    print_row(internnav, "InternVLA-N1's functions", check_internnav(internnav, checkout))


def check_navdp(export: Path, checkout: Path) -> str:
    """Checks that goals are ahead of the robot, and that no driven path meets an obstacle."""
    spec = importlib.util.spec_from_file_location("navdp", checkout / DATASETS / "navdp_lerobot_dataset.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with tempfile.TemporaryDirectory() as place:
        dataset = module.NavDP_Base_Datset(str(export / "data"), f"{place}/index.json", 8, 24, 64, 224)
    count = len(dataset) // 50  # the loader repeats its list
    nearest, ahead = np.inf, 0
    for number in range(count):
        _, extrinsic, poses, length = dataset.process_data_parquet(number)
        assert length == len(dataset.trajectory_rgb_path[number]) == len(dataset.trajectory_depth_path[number])
        assert all(path.name[:9] == Path(dataset.trajectory_depth_path[number][0]).name[:9]
                   for path in map(Path, dataset.trajectory_rgb_path[number]))  # fmt: skip
        obstacles, _ = dataset.process_obstacle_points(number)
        assert len(obstacles) > 100
        nearest = min(nearest, np.abs(poses[:, None, :2, 3] - obstacles[None, :, :2]).sum(axis=-1).min())
        half = length // 2
        _, point = dataset.relative_pose(
            poses[half, :3, :3], poses[half, :3, 3], poses[-1, :3, :3], poses[-1, :3, 3], extrinsic
        )
        assert abs(point[2]) < 0.02
        ahead += point[0] > 0.0
        sample = dataset[number]
        assert sample[3].shape == (8, 224, 224, 3)
        assert 0.1 < float(sample[4].max()) <= 5.0
    assert nearest > 0.05, nearest
    assert ahead == count, f"the end is behind the robot in {count - ahead} of {count} episodes"
    return f"{count} episodes, all ends ahead; nearest obstacle {nearest:.2f} m from the camera"


def functions_of(checkout: Path) -> dict[str, Any]:
    """Returns the functions of InternVLA-N1's module that read data."""
    tree = ast.parse((checkout / DATASETS / "internvla_n1_lerobot_dataset.py").read_text())
    chosen = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name in FUNCTIONS]
    assert {node.name for node in chosen} == set(FUNCTIONS)
    import os

    names: dict[str, Any] = {"np": np, "os": os, "json": json, "CubicSpline": CubicSpline}
    # the module itself cannot be imported without the packages of a language model
    exec(compile(ast.Module(chosen, []), "internvla", "exec"), names)
    return names


def check_internnav(export: Path, checkout: Path) -> str:
    """Checks poses, turns and goals as `NavPixelGoalDataset` uses them."""
    functions = functions_of(checkout)
    table = next((export / "data").glob("*/videos/chunk-000/observation.images.rgb.*"))
    setting = table.name.removeprefix("observation.images.rgb.")
    episodes = functions["get_annotations_from_lerobot_data"](str(export / "data"), setting)["episodes"]
    assert len(episodes) == sum(
        len(path.read_text().splitlines()) for path in export.glob("data/*/meta/episodes.jsonl")
    )
    goals = turns = 0
    for episode in episodes:
        poses = np.array([np.stack(pose) for pose in episode[f"poses_{setting}"]])
        local = functions["get_trajectory_relative_to_frame"](poses)
        for k in range(1, len(local)):
            change = (local[k, 2] - local[k - 1, 2] + np.pi) % (2 * np.pi) - np.pi
            if episode["actions"][k] in {LEFT, RIGHT}:
                turns += 1
                assert (change > 0) == (episode["actions"][k] == LEFT)
        for k, (ahead, goal) in enumerate(episode["pixel_goals"]):
            name = f"{episode['video']}/observation.images.rgb.{setting}/episode_{episode['id']:06d}_{k}.jpg"
            with Image.open(name) as image, Image.open(name.replace("rgb", "depth").replace(".jpg", ".png")) as depth:
                assert image.size == depth.size
                if ahead == -1:
                    continue
                goals += 1
                assert 0 <= goal[0] < image.size[1]
                assert 0 <= goal[1] < image.size[0]
                assert goal[0] > image.size[1] / 2, "a point of the floor is below the horizon"
            there = functions["get_trajectory_relative_to_frame"](poses[k:])[ahead]
            assert there[0] > 0.0
            assert (there[1] > 0.05) <= (goal[1] < image.size[0] / 2 + 60)
        sampled, deltas = functions["interpolate_and_resample_trajectory"](local, 32)
        assert np.isfinite(sampled).all()
        assert np.isfinite(deltas).all()
    assert goals
    return f"{len(episodes)} episodes, {goals} pixel goals, {turns} turns"


if __name__ == "__main__":
    main()
