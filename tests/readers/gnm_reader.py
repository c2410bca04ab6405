"""Checks that a GNM export meets the expectations of the GNM, ViNT and NoMaD loaders, with their loader if available.

Does not import this project. Exits with code 1 at the first failed check.

    python tests/readers/gnm_reader.py PAPER EXPORT [CHECKOUT]

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to gnm`. CHECKOUT:
robodhruv/visualnav-transformer, which is not on a package index; its loader needs torch, torchvision, lmdb and tqdm.
"""

import math
import pickle
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from paper_tree import Paper, psnr
from PIL import Image
from result import named, print_row

NAME = "minivla_nav"
CONTEXT, PREDICTED = 5, 5
LEAST_PSNR_DB = 30.0
BACK_M = 0.01
"""Permitted motion backwards, metres: the robot never reverses, but its body rocks back when it brakes."""


class PlainNumpy(pickle.Unpickler):
    """Permits only pickles of `numpy.array` with lists of floats, which numpy 1.x and 2.x can both read."""

    def find_class(self, module: str, name: str) -> Any:
        assert (module, name) in {("numpy", "array"), ("_codecs", "encode")}, f"the pickle names {module}.{name}"
        return super().find_class(module, name)


def main() -> None:
    paper, export = Paper(Path(sys.argv[1])), Path(sys.argv[2])
    print_row(export, named("pillow", "numpy"), check_expectations(paper, export))
    if len(sys.argv) < 4:
        sys.stderr.write("ViNT's own loader was not tested: give a checkout of robodhruv/visualnav-transformer\n")
        return
    with tempfile.TemporaryDirectory() as place:
        splits = prepare(Path(sys.argv[3]), export, Path(place))
        for split in ("train", "test"):
            print_row(export, f"ViNT_Dataset, {named('torch')}", check_loader(export, splits / split))


def check_expectations(paper: Paper, export: Path) -> str:
    """Checks lists, pickles, images and configuration as the published loaders read them."""
    lists = {path.parent.name: path.read_text().split() for path in export.glob(f"data_splits/{NAME}/*/traj_names.txt")}
    assert {"train", "test"} <= lists.keys()
    assert not set(lists["train"]) & set(lists["test"])
    names = sorted(path.name for path in (export / NAME).iterdir())
    assert names == sorted(path.name for path in paper.episodes.iterdir())
    assert {name for split in lists.values() for name in split} == set(names)
    steps, worst, pictures = [], np.inf, 0
    for name in names:
        with (export / NAME / name / "traj_data.pkl").open("rb") as file:
            data = PlainNumpy(file).load()
        position, yaw = data["position"], data["yaw"]
        check_trajectory(paper.array(name, "poses").astype(np.float64), position, yaw)
        steps.append(np.linalg.norm(np.diff(position, axis=0), axis=1))
        images = sorted((export / NAME / name).glob("*.jpg"), key=lambda path: int(path.stem))
        assert [path.stem for path in images] == [str(number) for number in range(len(position))]
        seen = (psnr(np.asarray(Image.open(path)), paper.rgb(name, t)) for t, path in enumerate(images))
        worst, pictures = min(worst, *seen), pictures + len(images)
    assert worst >= LEAST_PSNR_DB, f"{worst:.1f} dB"
    config = yaml.safe_load((export / "data_config.yaml").read_text())[NAME]
    spacing = float(np.concatenate(steps).mean())
    assert abs(config["metric_waypoint_spacing"] - spacing) < 1e-6, f"{config['metric_waypoint_spacing']}, {spacing}"
    return (
        f"{pictures} JPEGs of {len(names)} trajectories, at least {worst:.1f} dB; positions, headings, lists, spacing"
    )


def check_trajectory(poses: np.ndarray, position: np.ndarray, yaw: np.ndarray) -> None:
    """Checks that the arrays equal the poses, and that each waypoint is ahead of the previous pose."""
    assert (position.dtype, yaw.dtype, position.shape, yaw.shape) == (float, float, (len(poses), 2), (len(poses),))
    np.testing.assert_array_equal(position, poses[:, :2])
    w, x, y, z = poses[:, 3:].T
    turned = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y**2 + z**2)) - yaw
    assert np.abs(np.remainder(turned + math.pi, 2 * math.pi) - math.pi).max() < 1e-6
    cos, sin = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    ahead = np.diff(position[:, 0]) * cos + np.diff(position[:, 1]) * sin
    assert ahead.min() > -BACK_M, f"a waypoint lies {-ahead.min():.4f} m behind a robot that never reverses"


def prepare(checkout: Path, export: Path, place: Path) -> Path:
    """Copies the loader, with the configuration of the export, to an importable folder; also copies the split lists.

    Returns the folder of the copied lists, in which the loader stores its caches.
    """
    code = place / "train"
    shutil.copytree(checkout / "train/vint_train/data", code / "vint_train/data")
    (code / "vint_train/__init__.py").touch()
    (code / "vint_train/data/__init__.py").touch()
    shutil.copy(export / "data_config.yaml", code / "vint_train/data/data_config.yaml")
    shutil.copytree(export / f"data_splits/{NAME}", place / "splits")
    sys.path.insert(0, str(code))
    return place / "splits"


def check_loader(export: Path, split_folder: Path) -> str:
    """Creates the loader of ViNT and NoMaD and checks forty samples."""
    from vint_train.data.vint_dataset import ViNT_Dataset

    dataset = ViNT_Dataset(
        data_folder=str(export / NAME),
        data_split_folder=str(split_folder),
        dataset_name=NAME,
        image_size=(85, 64),
        waypoint_spacing=1,
        min_dist_cat=0,
        max_dist_cat=20,
        min_action_distance=0,
        max_action_distance=10,
        negative_mining=True,
        len_traj_pred=PREDICTED,
        learn_angle=True,
        context_size=CONTEXT,
    )
    names = (split_folder / "traj_names.txt").read_text().split()
    lengths = [len(list((export / NAME / name).glob("*.jpg"))) for name in names]
    expected = sum(max(0, length - CONTEXT - PREDICTED) for length in lengths)
    assert len(dataset) == expected, f"{split_folder.name}: {len(dataset)} samples, expected {expected}"
    ahead = []
    for number in np.linspace(0, len(dataset) - 1, min(len(dataset), 40)).astype(int):
        seen, goal, actions, distance, _, _, _ = dataset[int(number)]
        assert seen.shape == (3 * (CONTEXT + 1), 64, 85)
        assert goal.shape == (3, 64, 85)
        assert 0 <= float(seen.min()) <= float(seen.max()) <= 1
        assert 0 <= int(distance) <= 20
        ahead.append(actions.numpy())
    waypoints = np.stack(ahead)
    spacing = yaml.safe_load((export / "data_config.yaml").read_text())[NAME]["metric_waypoint_spacing"]
    back = float(waypoints[:, -1, 0].min()) * spacing
    assert back > -BACK_M, f"a waypoint lies {-back:.3f} m behind a robot that never reverses"
    return f"{split_folder.name}: {len(dataset)} samples of {len(names)} trajectories"


if __name__ == "__main__":
    main()
