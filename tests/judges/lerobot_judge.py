"""LeRobot's own loader opens our exports and finds in them what the paper's tree of the same dataset holds.

Runs in an environment of its own (Python 3.12, `lerobot[dataset]==0.6.1`, see `make test-formats`), imports nothing of
ours, and ends with exit code 1 at the first thing that is not right.

    python tests/judges/lerobot_judge.py PAPER EXPORT [EXPORT ...]

PAPER: the dataset as `factory export --to paper`. EXPORT: the same episodes as `factory export --to lerobot`, with any
of `--fps`, `--depth` and `--ids`; or as `--to lerobot-v2.1`, which LeRobot's own converter first makes v3.0 of.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

import datasets
import numpy as np
import torch
from lerobot.datasets.aggregate import aggregate_datasets
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts.convert_dataset_v21_to_v30 import convert_dataset
from paper_tree import Paper, mean_commands, psnr

RGB, DEPTH, IDS = "observation.images.front", "observation.images.front_depth", "observation.images.front_ids"
LEAST_PSNR_DB = 30.0
RECORDED_HZ = 60


def say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main() -> None:
    paper = Paper(Path(sys.argv[1]))
    for export in map(Path, sys.argv[2:]):
        if json.loads((export / "meta/info.json").read_text())["codebase_version"] == "v2.1":
            say(f"{export.name}: {judge_conversion(paper, export)}")
            continue
        for backend in backends():
            say(f"{export.name}, {backend}: {judge(paper, export, backend)}")
        say(f"{export.name}: {judge_batches(export)}")
        say(f"{export.name}: {judge_aggregate(export)}")
        say(f"{export.name}: {judge_parquet(export)}")


def backends() -> list[str]:
    """Returns the video decoders that work here; torchcodec needs FFmpeg's shared libraries."""
    try:
        import torchcodec  # noqa: F401
    except (ImportError, RuntimeError, OSError):
        say("torchcodec does not load here (FFmpeg's libraries?); judged with pyav only")
        return ["pyav"]
    return ["pyav", "torchcodec"]


def judge(paper: Paper, export: Path, backend: str) -> str:
    """Compares every episode's rows, and frames at its beginning, middle and end, with the paper's tree."""
    data = LeRobotDataset("judge/nav", root=export, video_backend=backend)
    stride = RECORDED_HZ // data.fps
    assert len(data) == data.meta.total_frames == sum(data.meta.episodes["length"])
    worst, deepest, compared = np.inf, 0.0, 0
    for episode in data.meta.episodes:
        name, start, length = episode["episode_id"], episode["dataset_from_index"], episode["length"]
        meta = paper.meta(name)
        assert episode["tasks"] == [meta["job"]["instruction"]], episode["tasks"]
        assert episode["split"] == meta["job"]["split"]
        actions, poses = paper.array(name, "actions_continuous"), paper.array(name, "poses")
        assert length == len(range(0, len(actions), stride))
        rows = data.hf_dataset.select(range(start, start + length))
        assert np.array_equal(np.stack(list(rows["pose"])), poses[::stride])
        assert np.allclose(np.stack(list(rows["action"])), mean_commands(actions, stride), atol=1e-6)
        for frame in sorted({0, 1, length // 2, length - 2, length - 1}):
            item, t = data[start + frame], frame * stride
            assert item["task"] == meta["job"]["instruction"]
            assert item["episode_index"] == episode["episode_index"]
            assert item["frame_index"] == frame
            assert abs(float(item["timestamp"]) - frame / data.fps) < 1e-4
            shown = np.rint(item[RGB].numpy().transpose(1, 2, 0) * 255.0)
            worst = min(worst, psnr(shown, paper.rgb(name, t)))
            if DEPTH in item:
                deepest = max(deepest, depth_error_mm(item[DEPTH].numpy()[0], paper.depth(name, t)))
            if IDS in item:
                assert np.array_equal(item[IDS].numpy()[0], paper.ids(name, t))
            compared += 1
    assert worst >= LEAST_PSNR_DB, f"{worst:.1f} dB"
    said = f"{len(data)} frames, {compared} compared, RGB at least {worst:.1f} dB"
    return said + (f", depth at most {deepest:.1f} mm off" if DEPTH in data.features else "")


def depth_error_mm(found_mm: np.ndarray, truth_m: np.ndarray) -> float:
    """Returns the largest error; asserts that it is within half a step of the code, and that nothing stays nothing."""
    assert np.array_equal(found_mm == 0, truth_m < 0.001)
    half_step_mm = 1000 * (truth_m + 3.5) * (np.log(33.5 / 3.5) / 4095) / 2 + 0.6  # the loader rounds to millimetres
    error = np.abs(found_mm - 1000.0 * truth_m)
    assert (error <= half_step_mm).all(), f"{error.max():.1f} mm"
    return float(error.max())


def judge_batches(export: Path) -> str:
    """Chunks of actions, images from the past, a filter by split, and a shuffled loader with worker processes."""
    info = json.loads((export / "meta/info.json").read_text())
    step = 1 / info["fps"]
    deltas = {RGB: [-step, 0.0], "action": [step * n for n in range(8)]}
    # pyav: LeRobot keeps torchcodec's decoders and their open files, which forked loader processes would share
    data = LeRobotDataset("judge/nav", root=export, delta_timestamps=deltas, video_backend="pyav")
    last = data[data.meta.episodes[0]["length"] - 1]
    assert last["action"].shape == (8, 2)
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
    for split, span in info["splits"].items():
        start, stop = map(int, span.split(":"))
        chosen = data.meta.filter_episodes(lambda episode, wanted=split: episode["split"] == wanted)
        assert chosen == list(range(start, stop)), (split, span, chosen)
    start, stop = map(int, next(iter(info["splits"].values())).split(":"))
    part = LeRobotDataset("judge/nav", root=export, episodes=list(range(start, stop)))
    assert len(part) == sum(data.meta.episodes["length"][start:stop])
    return f"chunks, filters and {number + 1} shuffled batches of {len(info['splits'])} splits"


def judge_conversion(paper: Paper, export: Path) -> str:
    """LeRobot makes version 3.0 of an export of version 2.1, which then holds the same."""
    with tempfile.TemporaryDirectory() as place:
        copy = Path(place) / "export"
        shutil.copytree(export, copy)
        convert_dataset("judge/nav", root=copy, push_to_hub=False)
        return f"converted by LeRobot, pyav: {judge(paper, copy, 'pyav')}"


def judge_aggregate(export: Path) -> str:
    """LeRobot joins the export with itself; the second half equals the first."""
    with tempfile.TemporaryDirectory() as place:
        target = Path(place) / "joined"
        aggregate_datasets(["judge/a", "judge/b"], "judge/joined", roots=[export, export], aggr_root=target)
        joined, one = LeRobotDataset("judge/joined", root=target), LeRobotDataset("judge/nav", root=export)
        assert len(joined) == 2 * len(one)
        for index in (0, len(one) - 1):
            assert torch.equal(joined[index + len(one)][RGB], one[index][RGB])
    return "aggregate_datasets of two copies"


def judge_parquet(export: Path) -> str:
    """`datasets` opens both configurations that the card names."""
    with tempfile.TemporaryDirectory() as cache:
        frames = datasets.load_dataset(str(export), "frames", split="train", cache_dir=cache)
        episodes = datasets.load_dataset(str(export), "episodes", split="train", cache_dir=cache)
        assert len(frames) == sum(episodes["length"])
        assert len(frames[0]["action"]) == 2
    return f"datasets.load_dataset: {len(frames)} frames, {len(episodes)} episodes"


if __name__ == "__main__":
    main()
