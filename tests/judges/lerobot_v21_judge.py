"""LeRobot 0.3's own loader opens a v2.1 export, and the rules of GR00T's loaders hold for it.

Runs in an environment of its own (Python 3.12, `lerobot==0.3.3 av==15.1.0`, the last release that reads v2.1; see
`make test-formats`), imports nothing of ours, and ends with exit code 1 at the first thing that is not right.

    python tests/judges/lerobot_v21_judge.py PAPER EXPORT [EXPORT ...]

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to lerobot-v2.1`.
Isaac-GR00T is in no package index: what its `LeRobotSingleDataset` (N1, N1.5) and `LeRobotEpisodeLoader` (N1.6 on) do
with `meta/modality.json` is done here in their manner.
"""

import json
import sys
from pathlib import Path
from typing import Any

import av
import numpy as np
import pandas as pd
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from paper_tree import Paper, mean_commands, psnr

RGB = "observation.images.front"
LEAST_PSNR_DB = 30.0
RECORDED_HZ = 60
DEFAULT_COLUMN = {"state": "observation.state", "action": "action"}
NEEDED_STATISTICS = {"min", "max", "mean", "std", "q01", "q99"}


def say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> None:
    paper = Paper(Path(sys.argv[1]))
    for export in map(Path, sys.argv[2:]):
        say(f"{export.name}: {judge_lerobot(paper, export)}")
        say(f"{export.name}: {judge_batches(export)}")
        say(f"{export.name}: {judge_statistics(export)}")
        say(f"{export.name}: {judge_gr00t(paper, export)}")


def judge_lerobot(paper: Paper, export: Path) -> str:
    """Compares every episode's rows, and frames at its beginning, middle and end, with the paper's tree."""
    data = LeRobotDataset("judge/nav", root=export, video_backend="pyav")
    stride = RECORDED_HZ // data.fps
    about = lines_of(export / "meta/episodes.jsonl")
    assert data.num_episodes == len(about)
    assert len(data) == data.meta.total_frames == sum(line["length"] for line in about)
    worst, compared, start = np.inf, 0, 0
    for line in about:
        name, length = line["episode_id"], line["length"]
        instruction = paper.meta(name)["job"]["instruction"]
        actions, poses = paper.array(name, "actions_continuous"), paper.array(name, "poses")
        assert length == len(range(0, len(actions), stride))
        rows = data.hf_dataset.select(range(start, start + length))
        assert np.array_equal(np.stack(list(rows["pose"])), poses[::stride])
        assert np.allclose(np.stack(list(rows["action"])), mean_commands(actions, stride), atol=1e-6)
        for frame in sorted({0, 1, length // 2, length - 2, length - 1}):
            item = data[start + frame]
            assert item["task"] == instruction
            assert (int(item["episode_index"]), int(item["frame_index"])) == (line["episode_index"], frame)
            shown = np.rint(item[RGB].numpy().transpose(1, 2, 0) * 255.0)
            worst = min(worst, psnr(shown, paper.rgb(name, frame * stride)))
            compared += 1
        start += length
    assert worst >= LEAST_PSNR_DB, f"{worst:.1f} dB"
    return f"LeRobot: {len(data)} frames, {compared} compared, RGB at least {worst:.1f} dB"


def judge_batches(export: Path) -> str:
    """Chunks of actions as openpi asks for them, a part by episodes, and a shuffled loader with worker processes."""
    fps = json.loads((export / "meta/info.json").read_text())["fps"]
    deltas = {RGB: [-1 / fps, 0.0], "action": [n / fps for n in range(8)]}
    data = LeRobotDataset("judge/nav", root=export, delta_timestamps=deltas, video_backend="pyav")
    first = data.meta.episodes[0]["length"]
    last = data[first - 1]
    assert last["action_is_pad"].tolist() == [False] + [True] * 7
    assert last[RGB].shape == (2, 3, 640, 640)
    loader = torch.utils.data.DataLoader(
        data, batch_size=8, shuffle=True, num_workers=2, generator=torch.Generator().manual_seed(0)
    )
    seen = set()
    for number, batch in enumerate(loader):
        assert batch["action"].shape[1:] == (8, 2)
        assert batch[RGB].shape[1:] == (2, 3, 640, 640)
        seen |= set(batch["episode_index"].tolist())
        if number == 7:
            break
    assert len(seen) > 1
    part = LeRobotDataset("judge/nav", root=export, episodes=[0], video_backend="pyav")
    assert len(part) == first
    assert part[first - 1]["task"] == data.meta.episodes[0]["tasks"][0]
    return f"LeRobot: chunks, one episode alone, {number + 1} shuffled batches"


def judge_statistics(export: Path) -> str:
    """What LeRobot adds up from the episodes is what the export says of all of them."""
    added = LeRobotDataset("judge/nav", root=export, video_backend="pyav").meta.stats
    told = json.loads((export / "meta/stats.json").read_text())
    assert added.keys() == told.keys()
    for key, found in added.items():
        for name in ("min", "max", "mean", "std"):
            np.testing.assert_allclose(found[name], told[key][name], rtol=1e-5, atol=1e-6, err_msg=f"{key} {name}")
    return f"LeRobot: statistics of {len(added)} features added up"


def judge_gr00t(paper: Paper, export: Path) -> str:
    """Reads every episode by the names of `meta/modality.json`."""
    info = json.loads((export / "meta/info.json").read_text())
    modality = json.loads((export / "meta/modality.json").read_text())
    tasks = {line["task_index"]: line["task"] for line in lines_of(export / "meta/tasks.jsonl")}
    judge_gr00t_statistics(export, modality)
    for name in modality["video"]:
        judge_gr00t_camera(info["features"][modality["video"][name].get("original_key", name)], info["fps"])
    for line in lines_of(export / "meta/episodes.jsonl"):
        number = line["episode_index"]
        place = {"episode_chunk": number // info["chunks_size"], "episode_index": number}
        table = pd.read_parquet(export / info["data_path"].format(**place))
        assert len(table) == line["length"]
        parts = {kind: parts_of(kind, modality, table) for kind in DEFAULT_COLUMN}
        judge_motion(paper, line["episode_id"], parts, RECORDED_HZ // info["fps"])
        for entry in modality["annotation"].values():
            assert [tasks[index] for index in table[entry["original_key"]]] == line["tasks"] * len(table)
        for name, entry in modality["video"].items():
            key = entry.get("original_key", name)
            times = times_of(export / info["video_path"].format(**place, video_key=key))
            nearest = [int(np.abs(times - wanted).argmin()) for wanted in table["timestamp"]]
            assert nearest == list(range(len(table))), f"{key}: frames at {times}"
    return f"GR00T: {sum(len(modality[kind]) for kind in modality)} names of modality.json in every episode"


def judge_gr00t_statistics(export: Path, modality: dict[str, Any]) -> None:
    """A part of state or action is cut out of every statistic of its column."""
    stats = json.loads((export / "meta/stats.json").read_text())
    for found in stats.values():
        assert found.keys() >= NEEDED_STATISTICS
    for kind, column in DEFAULT_COLUMN.items():
        for name, part in modality[kind].items():
            chosen = np.arange(part["start"], part["end"])
            for statistic, values in stats[part.get("original_key", column)].items():
                assert np.array(values)[chosen].shape == chosen.shape, f"{kind}.{name} of {statistic}: {values}"


def judge_gr00t_camera(feature: dict[str, Any], fps: int) -> None:
    names = feature["names"]
    assert [feature["shape"][names.index(side)] for side in ("height", "width", "channels")] == [640, 640, 3]
    assert feature["info"]["video.fps"] == fps


def parts_of(kind: str, modality: dict[str, Any], table: pd.DataFrame) -> dict[str, np.ndarray]:
    """Returns the parts of state or action of an episode, each (T, D)."""
    found = {}
    for name, part in modality[kind].items():
        column = np.stack(table[part.get("original_key", DEFAULT_COLUMN[kind])].to_list())
        assert column.ndim == 2
        assert column.dtype == np.dtype(part["dtype"]), f"{kind}.{name}: {column.dtype}"
        found[name] = column[:, np.arange(part["start"], part["end"])]
    return found


def judge_motion(paper: Paper, name: str, parts: dict[str, dict[str, np.ndarray]], stride: int) -> None:
    """The parts are what their names say, held against poses and commands of the paper's tree."""
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
    """Returns when each frame of a video is shown, in seconds."""
    with av.open(str(video)) as container:
        return np.array([frame.time for frame in container.decode(video=0)])


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


if __name__ == "__main__":
    main()
