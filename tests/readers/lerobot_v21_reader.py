"""Opens a v2.1 export with LeRobot 0.3's loader and checks the rules of GR00T's loaders.

Runs in a separate environment (Python 3.12, `lerobot==0.3.3 av==15.1.0`, the last release that reads v2.1; see
`make test-formats`), does not import this project, and exits with code 1 at the first failed check.

    python tests/readers/lerobot_v21_reader.py PAPER EXPORT [EXPORT ...]

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to lerobot-v2.1`.
Isaac-GR00T is not on a package index: the operations of `LeRobotSingleDataset` (N1, N1.5) and
`LeRobotEpisodeLoader` (N1.6 on) on `meta/modality.json` are reimplemented here.
"""

import json
import sys
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot_frames import RECORDED_HZ, Listed, check_batches, check_frames
from paper_tree import Paper, mean_commands
from result import named, print_row
from snippets import run_snippets

DEFAULT_COLUMN = {"state": "observation.state", "action": "action"}
NEEDED_STATISTICS = {"min", "max", "mean", "std", "q01", "q99"}


def main() -> None:
    paper, reader = Paper(Path(sys.argv[1])), named("lerobot")
    for export in map(Path, sys.argv[2:]):
        print_row(export, f"{reader}, pyav", check_lerobot(paper, export))
        print_row(export, reader, f"{run_snippets(export / 'README.md', export, 'lerobot')} printed snippet runs")
        print_row(export, reader, check_parts(export))
        print_row(export, reader, check_statistics(export))
        print_row(export, "operations of GR00T's loaders", check_gr00t(paper, export))


def check_lerobot(paper: Paper, export: Path) -> str:
    data = LeRobotDataset("test/nav", root=export, video_backend="pyav")
    listed = [
        Listed(line["episode_id"], line["episode_index"], line["length"], line["split"], line["tasks"])
        for line in lines_of(export / "meta/episodes.jsonl")
    ]
    assert data.num_episodes == len(listed)
    return check_frames(paper, data, listed)


def check_parts(export: Path) -> str:
    """Checks chunks of actions as openpi requests them, shuffled batches, and a single episode."""
    first = lines_of(export / "meta/episodes.jsonl")[0]
    _, result = check_batches(export, first["length"])
    part = LeRobotDataset("test/nav", root=export, episodes=[0], video_backend="pyav")
    assert len(part) == first["length"]
    assert part[first["length"] - 1]["task"] == first["tasks"][0]
    return f"{result}, one episode read alone"


def check_statistics(export: Path) -> str:
    """Compares the statistics that LeRobot aggregates from the episodes with the statistics stored in the export."""
    added = LeRobotDataset("test/nav", root=export, video_backend="pyav").meta.stats
    values = json.loads((export / "meta/stats.json").read_text())
    assert added.keys() == values.keys()
    for key, found in added.items():
        for name in ("min", "max", "mean", "std"):
            np.testing.assert_allclose(found[name], values[key][name], rtol=1e-5, atol=1e-6, err_msg=f"{key} {name}")
    return f"statistics of {len(added)} features equal to LeRobot's"


def check_gr00t(paper: Paper, export: Path) -> str:
    """Reads every episode through the names in `meta/modality.json`."""
    info = json.loads((export / "meta/info.json").read_text())
    modality = json.loads((export / "meta/modality.json").read_text())
    tasks = {line["task_index"]: line["task"] for line in lines_of(export / "meta/tasks.jsonl")}
    check_gr00t_statistics(export, modality)
    for name in modality["video"]:
        check_gr00t_camera(info["features"][modality["video"][name].get("original_key", name)], info["fps"])
    for line in lines_of(export / "meta/episodes.jsonl"):
        number = line["episode_index"]
        place = {"episode_chunk": number // info["chunks_size"], "episode_index": number}
        table = pd.read_parquet(export / info["data_path"].format(**place))
        assert len(table) == line["length"]
        parts = {kind: parts_of(kind, modality, table) for kind in DEFAULT_COLUMN}
        check_motion(paper, line["episode_id"], parts, RECORDED_HZ // info["fps"])
        for entry in modality["annotation"].values():
            assert [tasks[index] for index in table[entry["original_key"]]] == line["tasks"] * len(table)
        for name, entry in modality["video"].items():
            key = entry.get("original_key", name)
            times = times_of(export / info["video_path"].format(**place, video_key=key))
            nearest = [int(np.abs(times - wanted).argmin()) for wanted in table["timestamp"]]
            assert nearest == list(range(len(table))), f"{key}: frames at {times}"
    return f"{sum(len(modality[kind]) for kind in modality)} names of modality.json in every episode"


def check_gr00t_statistics(export: Path, modality: dict[str, Any]) -> None:
    """Checks that each statistic of a column has a value for every element of the parts of state and action."""
    stats = json.loads((export / "meta/stats.json").read_text())
    for found in stats.values():
        assert found.keys() >= NEEDED_STATISTICS
    for kind, column in DEFAULT_COLUMN.items():
        for name, part in modality[kind].items():
            chosen = np.arange(part["start"], part["end"])
            for statistic, values in stats[part.get("original_key", column)].items():
                assert np.array(values)[chosen].shape == chosen.shape, f"{kind}.{name} of {statistic}: {values}"


def check_gr00t_camera(feature: dict[str, Any], fps: int) -> None:
    names = feature["names"]
    assert [feature["shape"][names.index(side)] for side in ("height", "width", "channels")] == [640, 640, 3]
    assert feature["info"]["video.fps"] == fps


def parts_of(kind: str, modality: dict[str, Any], table: pd.DataFrame) -> dict[str, np.ndarray]:
    """Returns the parts of state or action of an episode by name, each (T, D)."""
    found = {}
    for name, part in modality[kind].items():
        column = np.stack(table[part.get("original_key", DEFAULT_COLUMN[kind])].to_list())
        assert column.ndim == 2
        assert column.dtype == np.dtype(part["dtype"]), f"{kind}.{name}: {column.dtype}"
        found[name] = column[:, np.arange(part["start"], part["end"])]
    return found


def check_motion(paper: Paper, name: str, parts: dict[str, dict[str, np.ndarray]], stride: int) -> None:
    """Compares the parts of state and action with poses and commands of the paper's tree."""
    poses, actions = paper.array(name, "poses"), paper.array(name, "actions_continuous")
    odometry, twist = parts["state"]["odometry"], parts["state"]["twist"]
    way = np.linalg.norm(poses[::stride, :2] - poses[0, :2], axis=1)
    np.testing.assert_allclose(np.linalg.norm(odometry[:, :2], axis=1), way, atol=1e-4)
    assert odometry.shape[1] == 3
    assert twist.shape[1] == 2
    assert not odometry[0].any()
    np.testing.assert_allclose(parts["action"]["twist"], mean_commands(actions, stride), atol=1e-6)
    assert 0 <= parts["action"]["tokens"].min() <= parts["action"]["tokens"].max() <= 6


def times_of(video: Path) -> np.ndarray:
    """Returns the presentation time of each frame of a video, seconds."""
    with av.open(str(video)) as container:
        return np.array([frame.time for frame in container.decode(video=0)])


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


if __name__ == "__main__":
    main()
