"""Reads the recording of `factory view`, an MCAP export and LeRobot exports with Rerun, and checks their content.

Runs in an environment with `rerun-sdk` and this project (it calls `factory view`, but does not import the project).
Exits with code 1 at the first failed check.

    python tests/readers/rerun_reader.py DATASET PAPER MCAP LEROBOT [LEROBOT ...]

PAPER, MCAP, LEROBOT: the same episodes as `factory export --to` those formats.
"""

import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from paper_tree import Paper
from rerun.chunk import Chunk, RrdReader
from rerun.experimental import LeRobotReader
from result import named, print_row

CAMERA = "/world/robot/camera"
STRIDE = 4
STILL = ("/world/map", "/world/target", "/world/driven", "/world/robot/body", "/instruction")


def main() -> None:
    dataset, tree, mcap, *lerobots = map(Path, sys.argv[1:])
    paper, reader = Paper(tree), named("rerun-sdk")
    name = min(path.name for path in paper.episodes.iterdir())
    with tempfile.TemporaryDirectory() as place:
        seen, made = Path(place) / "view.rrd", Path(place) / "mcap.rrd"
        run("-m", "factory", "view", str(dataset), name, "-o", str(seen), "--stride", str(STRIDE))
        print_row(dataset, f"factory view, {reader}", check_view(paper, name, seen))
        run("-m", "rerun", "mcap", "convert", str(mcap / f"episodes/{name}.mcap"), "-o", str(made))
        print_row(mcap, reader, check_mcap(paper, name, made))
    for lerobot in lerobots:
        print_row(lerobot, f"LeRobotReader, {reader}", check_lerobot(lerobot))


def run(*words: str) -> None:
    subprocess.run([sys.executable, *words], stdout=subprocess.DEVNULL, check=True, timeout=600)


def check_view(paper: Paper, name: str, path: Path) -> str:
    """Checks poses of every step, depth and ids of every shown frame, map, target, path and instruction."""
    rows = rows_of(path)
    poses = paper.array(name, "poses")
    places = rows["/world/robot", "Transform3D:translation"]
    assert sorted(places) == list(range(len(poses)))
    np.testing.assert_allclose([places[t][0] for t in range(len(poses))], poses[:, :3], atol=1e-6)
    shown = range(0, len(poses), STRIDE)
    depth, ids = rows[f"{CAMERA}/depth", "DepthImage:buffer"], rows[f"{CAMERA}/ids", "SegmentationImage:buffer"]
    assert sorted(depth) == sorted(ids) == sorted(rows[f"{CAMERA}/rgb", "EncodedImage:blob"]) == list(shown)
    for t in shown:
        assert np.array(depth[t][0], np.uint8).tobytes() == paper.depth(name, t).tobytes()
        assert np.array(ids[t][0], np.uint8).tobytes() == paper.ids(name, t).tobytes()
    entities = {entity for entity, _ in rows}
    assert entities.issuperset(STILL), f"{set(STILL) - entities} are not in the recording"
    (words,) = rows["/instruction", "TextDocument:text"][None]
    assert paper.meta(name)["job"]["instruction"] in words
    return f"{name}: {len(poses)} poses, {len(shown)} frames of depth and ids equal; map, target, path, instruction"


def rows_of(path: Path) -> dict[tuple[str, str], dict[int | None, Any]]:
    """Returns the values by (entity, component) and step; static values have the step `None`."""
    found: dict[tuple[str, str], dict[int | None, Any]] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        steps = [None] * chunk.num_rows if chunk.is_static else batch["step"].to_pylist()
        for column in batch.schema.names:
            if ":" in column:
                values = batch[column].to_pylist()
                known = {step: value for step, value in zip(steps, values, strict=True) if value is not None}
                found.setdefault((chunk.entity_path, column), {}).update(known)
    return found


def check_mcap(paper: Paper, name: str, path: Path) -> str:
    """Checks that no topic has fewer messages than the episode has steps."""
    rows = Counter[str]()
    for chunk in RrdReader(path).stream():
        rows[chunk.entity_path] += chunk.num_rows
    steps = len(paper.array(name, "poses"))
    topics = ("/camera/rgb", "/camera/depth", "/camera/ids", "/tf", "/odom", "/action")
    assert all(rows[topic] >= steps for topic in topics), dict(rows)
    return f"{name}: {len(topics)} topics with {steps} messages each"


def check_lerobot(export: Path) -> str:
    """Checks the format version, that every episode is listed, and that the actions are not fewer than the frames."""
    info = json.loads((export / "meta/info.json").read_text())
    reader = LeRobotReader(export)
    assert reader.version == info["codebase_version"].partition(".")[0]
    assert reader.episodes() == list(range(info["total_episodes"]))
    actions = sum(rows_in(chunk, "/action") for number in reader.episodes() for chunk in reader.stream(number))
    assert actions >= info["total_frames"], f"{actions} actions, expected {info['total_frames']}"
    return f"{len(reader.episodes())} episodes of {reader.version}, {info['total_frames']} actions"


def rows_in(chunk: Chunk, entity: str) -> int:
    return int(chunk.num_rows) if chunk.entity_path == entity else 0


if __name__ == "__main__":
    main()
