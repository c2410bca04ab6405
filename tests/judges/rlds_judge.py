"""Judges the RLDS builder with TFDS: reads back what it built and compares every step; exits 1 and says what differs.

Run in an environment with `tensorflow`, `tensorflow-datasets` and this project, with the variables the builder had:

    MINIVLA_FPS=10 python tests/judges/rlds_judge.py DATASET BUILT
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import tensorflow_datasets as tfds

from factory.dataset import Dataset
from factory.export.rlds import rlds_steps


def main(dataset: Path, built: Path) -> None:
    data = Dataset(dataset)
    fps = int(os.environ["MINIVLA_FPS"]) if "MINIVLA_FPS" in os.environ else None
    builder = tfds.builder_from_directory(next(built.glob("minivla_nav/*")))
    episodes = steps = 0
    for split in builder.info.splits:
        for found in builder.as_dataset(split=split):
            episode = data[found["episode_metadata"]["episode_id"].numpy().decode()]
            assert episode.summary.split == split
            expected = list(rlds_steps(episode, fps, int(os.environ.get("MINIVLA_IMAGE_PX", "256"))))
            for ours, theirs in zip(expected, tfds.as_numpy(found["steps"]), strict=True):
                for name, value in ours["observation"].items():
                    np.testing.assert_array_equal(theirs["observation"][name], value)
                for name in ("action", "action_tokens", "reward", "discount", "is_first", "is_last", "is_terminal"):
                    np.testing.assert_array_equal(theirs[name], ours[name])
                assert theirs["language_instruction"].decode() == ours["language_instruction"]
            episodes, steps = episodes + 1, steps + len(expected)
    assert episodes == len(data), f"{episodes} episodes, expected {len(data)}"
    print(f"rlds: {episodes} episodes, {steps} steps in {len(builder.info.splits)} splits equal to the dataset")  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
