"""Checks shared by the readers of LeRobot 0.3 and 0.6: rows and frames of an export, chunks, shuffled batches.

Runs in the environments of the two readers; does not import this project.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from paper_tree import Paper, mean_commands, psnr

RGB, DEPTH, IDS = "observation.images.front", "depth.front", "ids.front"
LEAST_PSNR_DB = 30.0
RECORDED_HZ = 60
CHUNK, BATCHES = 8, 8


class Listed(NamedTuple):
    """An episode as the loader lists it."""

    name: str
    """Name of the original episode."""
    index: int
    length: int
    split: str
    tasks: list[str]


def check_frames(paper: Paper, data: Any, episodes: list[Listed], extra: Any = None) -> str:
    """Compares every episode's rows, and frames at its beginning, middle and end, with the paper's tree.

    `extra` is the second dataset of the export, with depth and ids of the same rows.
    """
    features = {} if extra is None else extra.features
    assert len(data) == data.meta.total_frames == sum(episode.length for episode in episodes)
    stride = RECORDED_HZ // data.fps
    worst, deepest, compared, start = np.inf, 0.0, 0, 0
    for episode in episodes:
        job = paper.meta(episode.name)["job"]
        assert (episode.tasks, episode.split) == ([job["instruction"]], job["split"])
        check_rows(paper, data, episode, start, stride)
        for frame in sorted({0, 1, episode.length // 2, episode.length - 2, episode.length - 1}):
            item, t = data[start + frame], frame * stride
            assert item["task"] == job["instruction"]
            assert (int(item["episode_index"]), int(item["frame_index"])) == (episode.index, frame)
            assert abs(float(item["timestamp"]) - frame / data.fps) < 1e-4
            shown = np.rint(item[RGB].numpy().transpose(1, 2, 0) * 255.0)
            worst = min(worst, psnr(shown, paper.rgb(episode.name, t)))
            if extra is not None:
                item = extra[start + frame] | item
            if DEPTH in features:
                deepest = max(deepest, depth_error_mm(item[DEPTH].numpy()[0], paper.depth(episode.name, t)))
            if IDS in features:
                assert np.array_equal(item[IDS].numpy()[0], paper.ids(episode.name, t))
            compared += 1
        start += episode.length
    assert worst >= LEAST_PSNR_DB, f"{worst:.1f} dB"
    result = f"{len(data)} frames, {compared} compared, RGB at least {worst:.1f} dB"
    result += f", depth at most {deepest:.1f} mm off" if DEPTH in features else ""
    return result + (", ids equal" if IDS in features else "")


def check_rows(paper: Paper, data: Any, episode: Listed, start: int, stride: int) -> None:
    """Compares poses and mean commands of all kept frames with the paper's tree."""
    actions, poses = paper.array(episode.name, "actions_continuous"), paper.array(episode.name, "poses")
    assert episode.length == len(range(0, len(actions), stride))
    rows = data.hf_dataset.select(range(start, start + episode.length))
    assert np.array_equal(np.stack(list(rows["pose"])), poses[::stride].astype(np.float32))
    assert np.allclose(np.stack(list(rows["action"])), mean_commands(actions, stride), atol=1e-6)
    is_last = np.arange(episode.length) == episode.length - 1
    for name in ("next.reward", "next.success", "next.done"):  # only successes are archived
        assert np.array_equal(np.ravel(list(rows[name])), is_last), name


def depth_error_mm(found_mm: np.ndarray, truth_m: np.ndarray) -> float:
    """Returns the largest error; asserts that errors are at most half a quantisation step, and that 0 remains 0."""
    assert np.array_equal(found_mm == 0, truth_m < 0.001)
    half_step_mm = 1000 * (truth_m + 3.5) * (np.log(33.5 / 3.5) / 4095) / 2 + 0.6  # 0.6: rounding by the loader
    error = np.abs(found_mm - 1000.0 * truth_m)
    assert (error <= half_step_mm).all(), f"{error.max():.1f} mm"
    return float(error.max())


def check_batches(export: Path, first_length: int) -> tuple[Any, str]:
    """Checks chunks of actions, past images, and a shuffled loader with worker processes; returns the dataset."""
    fps = json.loads((export / "meta/info.json").read_text())["fps"]
    deltas = {RGB: [-1 / fps, 0.0], "action": [n / fps for n in range(CHUNK)]}
    # not torchcodec, because forked loader processes would share the open files of its decoders
    data = LeRobotDataset("test/nav", root=export, delta_timestamps=deltas, video_backend="pyav")
    last = data[first_length - 1]
    assert last["action"].shape == (CHUNK, 2)
    assert last["action_is_pad"].tolist() == [False] + [True] * (CHUNK - 1)
    assert last[RGB].shape == (2, 3, 640, 640)
    seed = torch.Generator().manual_seed(0)
    loader = torch.utils.data.DataLoader(data, batch_size=8, shuffle=True, num_workers=2, generator=seed)
    seen = set()
    for number, batch in enumerate(loader, 1):
        assert batch["action"].shape[1:] == (CHUNK, 2)
        assert batch[RGB].shape[1:] == (2, 3, 640, 640)
        seen |= set(batch["episode_index"].tolist())
        if number == BATCHES:
            break
    assert len(seen) > 1
    return data, f"chunks of {CHUNK} actions, {number} shuffled batches of two loader processes"
