"""Program for the environment of a reader: opens a dataset through the public package and decodes it.

Usage: reader.py DATASET [MODULE ...]; the modules are imported first, to test that they work in one process.
"""

from __future__ import annotations

import importlib
import sys

from minivla import Dataset, FrameDataset

HEAVY = ("pybullet", "zenoh", "moderngl", "sqlalchemy")

for module in sys.argv[2:]:
    importlib.import_module(module)
dataset = Dataset(sys.argv[1])
episode = dataset[0]
frame = episode.frame(0)
assert frame.rgb.shape == (640, 640, 3), frame.rgb.shape
assert frame.depth.shape == frame.ids.shape == (640, 640)
assert episode.actions.shape == (len(episode), 2)
frames = FrameDataset(dataset)
assert len(frames) == sum(map(len, dataset))
assert frames[len(frames) - 1]["rgb"].shape == (640, 640, 3)
loaded = [name for name in HEAVY if name in sys.modules]
assert not loaded or sys.argv[2:], f"reading a dataset imported {loaded}"
print(f"read {len(dataset)} episodes, {len(frames)} frames, digest {dataset.digest}")  # noqa: T201
