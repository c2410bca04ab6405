"""`make check-rigs`: renders one states episode with three rigs and two appearances, and checks its exports.

Exports each rendered dataset to every format that can contain sensors, and opens each export with the reader of its
format: LeRobot's loader, the MCAP reader with its protobuf decoder, rosbags, webdataset, and OpenCV and numpy for the
paper layout. Prints one row for each export, and exits with 1 if a measurement of a sensor is missing.

    python -m tests.acceptance.check_rigs --lerobot PYTHON [--rig NAME ...] [--root DIR]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import tomli_w
import webdataset
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from factory.dataset.reader import Dataset
from schemas.rig import EquirectangularCamera, Rig, Sensor
from schemas.rig.arrays import arrays_of, is_of_motion, measured_steps
from schemas.rig.rig_file import load_rig

RIGS = ("paper", "turtlebot4", "nova-carter")
APPEARANCES = ("none", "varied")
RATE_HZ = 3.0
"""Rate of cameras and lidars in rigs with several sensors, Hz; low, because such rigs store megabytes for each step."""
PLAN = Path(__file__).parents[2] / "docs/training/near_office.toml"
READER = Path(__file__).parents[1] / "readers/lerobot_rig_reader.py"
Found = Counter[tuple[str, str]]
"""Number of measurements of each pair of sensor and array; the array has its name in the export format."""


def read_paper(out: Path) -> Iterable[tuple[str, str]]:
    """Yields sensor and array of each measurement that OpenCV and numpy read."""
    (folder,) = out.glob("episodes/*/sensors")
    for path in sorted(path for path in folder.rglob("*.*") if path.is_file()):
        sensor, array, *image = path.relative_to(folder).with_suffix("").parts
        value = np.load(path) if path.suffix == ".npy" else cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert value is not None, f"{path} is not an image"
        yield from [(sensor, array)] * (1 if image else len(value))


def read_webdataset(out: Path) -> Iterable[tuple[str, str]]:
    """Yields sensor and array of each member that webdataset decodes."""
    shards = [str(path) for path in sorted(out.glob("*.tar"))]
    for sample in webdataset.WebDataset(shards, shardshuffle=False).decode("rgb8"):
        yield from (_pair(name, ".") for name in sample)


def read_foxglove(out: Path) -> Iterable[tuple[str, str]]:
    """Yields sensor and topic of each message that the MCAP reader decodes."""
    (path,) = out.glob("episodes/*.mcap")
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        yield from (_pair(channel.topic[1:], "/") for _, channel, _, _ in reader.iter_decoded_messages())


def read_ros2(out: Path) -> Iterable[tuple[str, str]]:
    """Yields sensor and topic of each message that rosbags decodes."""
    (path,) = out.glob("episodes/*/")
    with AnyReader([path]) as bag:
        for connection, _, raw in bag.messages():
            bag.deserialize(raw, connection.msgtype)
            if not connection.topic.endswith("/camera_info"):
                yield _pair(connection.topic[1:], "/")


def _pair(name: str, separator: str) -> tuple[str, str]:
    sensor, array = f"{name}{separator}".split(separator)[:2]
    return sensor, array


def paper_arrays(sensor: Sensor) -> Iterable[str]:
    """Returns the names of the folders or files of a sensor in the paper layout."""
    return (name for name in arrays_of(sensor) if name != "cosines")


def webdataset_arrays(sensor: Sensor) -> Iterable[str]:
    """Returns the names of the members of a sensor in a webdataset sample."""
    return ("motion",) if is_of_motion(sensor) else paper_arrays(sensor)


def foxglove_topics(sensor: Sensor) -> Iterable[str]:
    """Returns the topics of a sensor in an MCAP file for Foxglove."""
    has_calibration = hasattr(sensor, "outputs") and not isinstance(sensor, EquirectangularCamera)
    return (*ros2_topics(sensor), *(("calibration",) if has_calibration else ()))


def ros2_topics(sensor: Sensor) -> Iterable[str]:
    """Returns the topics of a sensor in an MCAP file for ROS 2."""
    named = {"lidar2d": ("scan",), "lidar3d": ("points",), "imu": ("imu",), "odometry": ("odom",)}
    return named.get(sensor.model) or arrays_of(sensor)


class Reader(NamedTuple):
    """Export options and reader of a format."""

    words: tuple[str, ...]
    """Options of `factory export`."""
    read: Callable[[Path], Iterable[tuple[str, str]]]
    """Yields sensor and array of each measurement."""
    arrays: Callable[[Sensor], Iterable[str]]
    """Returns the arrays of a sensor in this format."""


READERS = {
    "paper": Reader(("--to", "paper"), read_paper, paper_arrays),
    "webdataset": Reader(("--to", "webdataset", "--fps", "3"), read_webdataset, webdataset_arrays),
    "mcap-foxglove": Reader(("--to", "mcap"), read_foxglove, foxglove_topics),
    "mcap-ros2": Reader(("--to", "mcap", "--ros2"), read_ros2, ros2_topics),
}


def check_export(name: str, out: Path, rig: Rig, steps: int, hz: int) -> str:
    """Counts the measurements in an export; returns the number of sensors and measurements as text.

    Raises:
        AssertionError: an array of a sensor has a different number of measurements than expected.
    """
    reader = READERS[name]
    every = 1 if name != "webdataset" else round(hz / RATE_HZ)
    expected = Found()
    for sensor in rig.sensors:
        times = len(range(0, steps, every)) if name == "webdataset" else len(measured_steps(sensor, steps, hz))
        expected.update({(sensor.name, array): times for array in reader.arrays(sensor)})
    found = Found(reader.read(out))
    differing = {key: (found[key], count) for key, count in expected.items() if found[key] != count}
    assert not differing, f"{out}: sensor, array: (found, expected) {differing}"
    return f"{len(rig.sensors)} sensors, {expected.total()} measurements"


def _factory(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "factory", *map(str, words)], check=True, stdout=subprocess.DEVNULL)


def _say(*cells: object) -> None:
    sys.stdout.write(f"| {' | '.join(map(str, cells))} |\n")
    sys.stdout.flush()


def write_slow_rig(name: str, folder: Path) -> Path:
    """Writes a built-in rig; if it has several sensors, its cameras and lidars measure at `RATE_HZ`."""
    rig = load_rig(name)
    is_fast = [len(rig.sensors) == 1 or is_of_motion(sensor) for sensor in rig.sensors]
    pairs = zip(rig.sensors, is_fast, strict=True)
    slow = [sensor if kept else sensor.model_copy(update={"rate_hz": RATE_HZ}) for sensor, kept in pairs]
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps(rig.model_copy(update={"sensors": tuple(slow)}).model_dump(exclude_none=True)))
    return path


def check_rig(states: Path, rig: Path, appearance: str, lerobot: str) -> None:
    """Renders the states with a rig and an appearance, exports the dataset, and opens each export."""
    loaded = load_rig(str(rig))
    root = rig.parent / f"{loaded.name}-{appearance}"
    _factory("render", states, "--rig", rig, "--appearance", appearance, "-o", root / "dataset", "--workers", 1)
    (episode,) = Dataset(root / "dataset")
    steps, hz = len(episode), episode.meta.job.task.control_hz
    for name, reader in READERS.items():
        _factory("export", root / "dataset", "--rig", rig, "-o", root / name, *reader.words, "--workers", 1)
        _say(root.name, name, check_export(name, root / name, loaded, steps, hz))
    words = ("--to", "lerobot", "--fps", 3, "--depth", "--ids", "--workers", 1)
    _factory("export", root / "dataset", "--rig", rig, "-o", root / "lerobot", *words)
    subprocess.run([lerobot, READER, root / "paper", root / "lerobot"], check=True)


def main() -> int:
    """Checks each rig with each appearance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lerobot", required=True, help="Python interpreter of an environment with LeRobot.")
    parser.add_argument("--rig", action="append", choices=RIGS, help="Rig to check. Default: all.")
    parser.add_argument("--root", type=Path, help="Folder that keeps the datasets. Default: a temporary folder.")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        root = (options.root or Path(temporary)).absolute()
        root.mkdir(exist_ok=True)
        _factory("run", PLAN, "--episodes", 1, "--record", "states", "--out", root / "states", "--workers", 1)
        for name in options.rig or RIGS:
            for appearance in APPEARANCES:
                check_rig(root / "states", write_slow_rig(name, root), appearance, options.lerobot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
