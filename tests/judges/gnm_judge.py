"""Judges a GNM export with the loader of ViNT and NoMaD itself; exits 1 and says what differs.

Run in an environment with torch, torchvision, lmdb and PyYAML, with a checkout of robodhruv/visualnav-transformer:

    python tests/judges/gnm_judge.py CHECKOUT EXPORT
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml

CONTEXT, PREDICTED = 5, 5


def main(checkout: Path, export: Path) -> None:
    with tempfile.TemporaryDirectory() as place:
        code = Path(place) / "train"
        shutil.copytree(checkout / "train/vint_train/data", code / "vint_train/data")
        (code / "vint_train/__init__.py").touch()
        (code / "vint_train/data/__init__.py").touch()
        shutil.copy(export / "data_config.yaml", code / "vint_train/data/data_config.yaml")
        splits = Path(place) / "splits"  # the loader keeps its caches beside the lists
        shutil.copytree(export / "data_splits/minivla_nav", splits)
        sys.path.insert(0, str(code))
        for split in ("train", "test"):
            judge(export, splits / split, split)


def judge(export: Path, split_folder: Path, split: str) -> None:
    from vint_train.data.vint_dataset import ViNT_Dataset

    dataset = ViNT_Dataset(
        data_folder=str(export / "minivla_nav"),
        data_split_folder=str(split_folder),
        dataset_name="minivla_nav",
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
    lengths = [len(list((export / "minivla_nav" / name).glob("*.jpg"))) for name in names]
    expected = sum(max(0, length - CONTEXT - PREDICTED) for length in lengths)
    assert len(dataset) == expected, f"{split}: {len(dataset)} samples, expected {expected}"
    ahead = []
    for number in np.linspace(0, len(dataset) - 1, min(len(dataset), 40)).astype(int):
        seen, goal, actions, distance, _, _, _ = dataset[int(number)]
        assert seen.shape == (3 * (CONTEXT + 1), 64, 85)
        assert goal.shape == (3, 64, 85)
        assert 0 <= float(seen.min()) <= float(seen.max()) <= 1
        assert 0 <= int(distance) <= 20
        ahead.append(actions.numpy())
    waypoints = np.stack(ahead)
    spacing = yaml.safe_load((export / "data_config.yaml").read_text())["minivla_nav"]["metric_waypoint_spacing"]
    back = float(waypoints[:, -1, 0].min()) * spacing
    assert back > -0.01, f"a waypoint lies {-back:.3f} m behind a robot that never reverses"
    mean = float(np.linalg.norm(waypoints[:, 0, :2], axis=1).mean())
    print(f"gnm {split}: {len(names)} trajectories, {len(dataset)} samples; first waypoint {mean:.2f} x {spacing} m")  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
