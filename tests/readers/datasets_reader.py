"""Checks that `datasets.load_dataset` opens a dataset and its supported exports through their dataset cards.

Does not import this project. Exits with code 1 at the first failed check.

    python tests/readers/datasets_reader.py DATASET PAPER LEROBOT WEBDATASET

PAPER, LEROBOT, WEBDATASET: the same episodes as `factory export --to` those formats.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import datasets
import numpy as np
from paper_tree import Paper
from result import named, print_row


def main() -> None:
    dataset, tree, lerobot, shards = map(Path, sys.argv[1:])
    paper = Paper(tree)
    with tempfile.TemporaryDirectory() as cache:
        for place, check in (
            (dataset, check_rows),
            (tree, check_rows),
            (lerobot, check_lerobot),
            (shards, check_shards),
        ):
            print_row(place, named("datasets"), check(paper, place, cache))


def check_rows(paper: Paper, place: Path, cache: str) -> str:
    """Checks that each episode has one row, in its split and with its instruction."""
    splits = datasets.load_dataset(str(place), cache_dir=cache)
    values = {
        row["episode_id"]: (row["instruction"], split, row["num_steps"])
        for split, table in splits.items()
        for row in table
    }
    assert values == {path.name: facts(paper, path.name) for path in paper.episodes.iterdir()}
    pictures = [row["thumbnail"] for table in splits.values() for row in table if "thumbnail" in row]
    assert {picture.size for picture in pictures} <= {(160, 160)}
    return f"{len(values)} rows in {len(splits)} splits, {len(pictures)} thumbnails"


def facts(paper: Paper, name: str) -> tuple[str, str, int]:
    job: dict[str, Any] = paper.meta(name)["job"]
    return job["instruction"], job["split"], len(paper.array(name, "poses"))


def check_lerobot(paper: Paper, place: Path, cache: str) -> str:
    """Checks both configurations of the card, with frames in the order of the episodes."""
    episodes = datasets.load_dataset(str(place), "episodes", split="train", cache_dir=cache)
    frames = datasets.load_dataset(str(place), "frames", split="train", cache_dir=cache).with_format("numpy")
    poses = np.concatenate([paper.array(name, "poses") for name in episodes["episode_id"]])
    np.testing.assert_array_equal(np.stack(list(frames["pose"])), poses.astype(np.float32))
    return f"frames: {len(frames)} rows with the poses of the paper's tree; episodes: {len(episodes)}"


def check_shards(paper: Paper, place: Path, cache: str) -> str:
    """Streams every split; checks all samples of its first episode and the names of all samples."""
    splits = sorted({shard["split"] for shard in json.loads((place / "shards.json").read_text())["shards"]})
    samples = 0
    for split in splits:
        stream = datasets.load_dataset(str(place), streaming=True, split=split, cache_dir=cache)
        for number, sample in enumerate(stream.with_format("numpy")):
            samples += 1
            name, t = str(sample["json"]["episode_id"]), int(sample["json"]["step"])
            assert paper.meta(name)["job"]["split"] == split
            if number < 2:
                np.testing.assert_array_equal(np.asarray(sample["rgb.png"]), paper.rgb(name, t))
                np.testing.assert_array_equal(sample["depth.npy.gz"], paper.depth(name, t))
                np.testing.assert_array_equal(sample["seg.npy.gz"], paper.ids(name, t))
    expected = sum(len(paper.array(path.name, "poses")) for path in paper.episodes.iterdir())
    assert samples == expected, f"{samples} samples, expected {expected}"
    return f"{samples} samples streamed from {len(splits)} splits"


if __name__ == "__main__":
    main()
