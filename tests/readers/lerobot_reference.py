"""Writes a dataset with the features of our exports with LeRobot's writer, and prints its schema.

    python tests/readers/lerobot_reference.py > tests/readers/lerobot_schema.json

Runs in the environment of `lerobot_reader.py`. Its output is stored in `lerobot_schema.json`; unit tests compare
exports with it.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from lerobot.configs.video import DepthEncoderConfig, RGBEncoderConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from PIL import Image

FPS, SIDE = 60, 640
POSE = {"dtype": "float32", "shape": (7,), "names": ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]}
MATRIX_NAMES = ["fx", "skew", "cx", "zero_10", "fy", "cy", "zero_20", "zero_21", "one"]
CAMERA = {
    "camera_pose.front": POSE,
    "camera_matrix.front": {"dtype": "float32", "shape": (9,), "names": MATRIX_NAMES},
}
FEATURES = {
    "observation.images.front": {"dtype": "video", "shape": (SIDE, SIDE, 3), "names": ["height", "width", "channels"]},
    "observation.state": {"dtype": "float32", "shape": (5,), "names": ["x_m", "y_m", "yaw_rad", "v_mps", "w_rps"]},
    "action": {"dtype": "float32", "shape": (2,), "names": ["v_mps", "w_rps"]},
    "tokens": {"dtype": "int64", "shape": (2,), "names": ["v", "w"]},
    "pose": POSE,
    **CAMERA,
    "next.reward": {"dtype": "float32", "shape": (1,), "names": None},
    "next.success": {"dtype": "bool", "shape": (1,), "names": None},
    "next.done": {"dtype": "bool", "shape": (1,), "names": None},
}
EXTRA = {
    "depth.front": {
        "dtype": "video",
        "shape": (SIDE, SIDE, 1),
        "names": ["height", "width", "channels"],
        "info": {"is_depth_map": True, "depth_unit": "m"},
    },
    "ids.front": {"dtype": "image", "shape": (SIDE, SIDE, 1), "names": ["height", "width", "channels"]},
    **CAMERA,
}


def main() -> None:
    with tempfile.TemporaryDirectory() as place:
        schemas = {}
        for name, features in {"main": FEATURES, "extra": EXTRA}.items():
            root = Path(place) / name
            write(root, features)
            schemas[name] = schema_of(root)
        json.dump(schemas, sys.stdout, indent=1)
        sys.stdout.write("\n")


def write(root: Path, features: dict[str, dict[str, object]]) -> None:
    rgb = RGBEncoderConfig(vcodec="h264", g=2, crf=19, preset="veryfast")
    depth = DepthEncoderConfig(depth_min=0.0, depth_max=30.0, g=10, preset="superfast")
    dataset = LeRobotDataset.create(
        "test/reference", FPS, features, root=root, robot_type="nova_carter", rgb_encoder=rgb, depth_encoder=depth
    )
    for _ in range(2):
        for t in range(4):
            dataset.add_frame({name: value for name, value in frame(t).items() if name in {*features, "task"}})
        dataset.save_episode()
    dataset.finalize()


def frame(t: int) -> dict[str, object]:
    return {
        "observation.images.front": np.full((SIDE, SIDE, 3), 40 * t, np.uint8),
        "depth.front": np.full((SIDE, SIDE, 1), 1.5 + t, np.float32),
        "ids.front": Image.fromarray(np.full((SIDE, SIDE), 300 + t, np.uint16)),
        "observation.state": np.arange(5, dtype=np.float32) + t,
        "action": np.arange(2, dtype=np.float32),
        "tokens": np.array([3, t], np.int64),
        "pose": np.arange(7, dtype=np.float32),
        "camera_pose.front": np.arange(7, dtype=np.float32),
        "camera_matrix.front": np.arange(9, dtype=np.float32),
        "next.reward": np.array([t == 3], np.float32),
        "next.success": np.array([t == 3]),
        "next.done": np.array([t == 3]),
        "task": "Go to the chair.",
    }


def schema_of(root: Path) -> dict[str, object]:
    """Returns keys, types and file names of a dataset, and the content of `info.json`, but no recorded values."""
    info = json.loads((root / "meta/info.json").read_text())
    stats = json.loads((root / "meta/stats.json").read_text())
    described = json.loads(pq.read_schema(root / "data/chunk-000/file-000.parquet").metadata[b"huggingface"])
    return {
        "info": info,
        "data": types_of(root / "data/chunk-000/file-000.parquet"),
        "data_features": {"info": described["info"]},
        "episodes": types_of(root / "meta/episodes/chunk-000/file-000.parquet"),
        "tasks": types_of(root / "meta/tasks.parquet"),
        "tasks_pandas": json.loads(pq.read_schema(root / "meta/tasks.parquet").metadata[b"pandas"]),
        "stats": {feature: sorted(values) for feature, values in stats.items()},
        "files": sorted(str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()),
    }


def types_of(path: Path) -> dict[str, str]:
    return {field.name: str(field.type) for field in pq.read_schema(path)}


if __name__ == "__main__":
    main()
