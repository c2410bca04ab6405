"""Opens an export with the sensors of a rig with LeRobot's loader and compares it with the paper layout.

Runs in the environment of `lerobot_reader.py`; does not import this project. Exits with code 1 at a failed check.

    python tests/readers/lerobot_rig_reader.py PAPER EXPORT

PAPER: the dataset as `factory export --to paper --rig RIG`. EXPORT: the same episodes as `factory export --to lerobot
--rig RIG --depth --ids`, at any frame rate.
"""

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from paper_tree import psnr
from PIL import Image
from result import named, print_row

LEAST_PSNR_DB = 25.0
FRAMES = 12


def main() -> None:
    paper, export = Path(sys.argv[1]), Path(sys.argv[2])
    rig = json.loads((export / "meta/rig.json").read_text())
    assert rig == json.loads((paper / "rig.json").read_text())
    data = LeRobotDataset("test/rig", root=export, video_backend="pyav")
    extra = LeRobotDataset("test/extra", root=export / "extra", video_backend="pyav")
    seen: Counter[str] = Counter()
    for found in data.meta.episodes:
        sensors = paper / "episodes" / found["episode_id"] / "sensors"
        for frame in np.linspace(0, found["length"] - 1, FRAMES).astype(int).tolist():
            row = found["dataset_from_index"] + frame
            item = extra[row] | data[row]
            for sensor in rig["sensors"]:
                step = frame * rig["control_hz"] // data.fps
                check_sensor(item, sensor, sensors / sensor["name"], step // sensor["every_steps"])
                seen[sensor["name"]] += 1
    assert set(seen) == {sensor["name"] for sensor in rig["sensors"]}
    result = f"{len(seen)} sensors of rig {rig['name']}, {seen.total()} measurements equal to the paper layout"
    print_row(export, f"{named('lerobot')}, pyav", result)


def check_sensor(item: dict[str, Any], sensor: dict[str, Any], folder: Path, number: int) -> None:
    """Compares the measurement of a sensor in a row of the export with measurement `number` of the paper layout."""
    name, file = sensor["name"], f"{number * sensor['every_steps']:06d}"
    match sensor["model"]:
        case "lidar2d" | "lidar3d":
            ranges = np.load(folder / f"ranges/{file}.npy")
            assert np.array_equal(np.atleast_2d(item[f"observation.{name}"].numpy()), ranges)
        case "imu":
            parts = [np.load(folder / f"{kind}.npy")[number] for kind in ("angular_velocity", "specific_force")]
            assert np.array_equal(item[f"observation.{name}"].numpy(), np.concatenate(parts))
        case "odometry":
            parts = [np.load(folder / f"{kind}.npy")[number] for kind in ("poses", "twists")]
            assert np.array_equal(item["observation.state"].numpy(), np.concatenate(parts).astype(np.float32))
        case _:
            check_camera(item, sensor, folder, file)


def check_camera(item: dict[str, Any], camera: dict[str, Any], folder: Path, file: str) -> None:
    """Compares the images that a camera records: colour, depth and ids, or some of them."""
    key = f"observation.images.{camera['name']}"
    if "rgb" in camera["outputs"]:
        shown = np.rint(item[key].numpy().transpose(1, 2, 0) * 255.0)
        found = psnr(shown, np.asarray(Image.open(folder / f"rgb/{file}.png")))
        assert found >= LEAST_PSNR_DB, f"{key} {found:.1f} dB"
    if "depth" in camera["outputs"]:
        truth = np.load(folder / f"depth/{file}.npy")
        assert np.abs(item[f"depth.{camera['name']}"].numpy()[0] / 1000 - truth).max() < 0.02
    if "ids" in camera["outputs"]:
        assert np.array_equal(
            item[f"ids.{camera['name']}"].numpy()[0], np.asarray(Image.open(folder / f"ids/{file}.png"))
        )


if __name__ == "__main__":
    main()
