"""Program for an environment with the extra `render`: renders frames of a states dataset in threads and processes.

Usage: states_reader.py DATASET
"""

from __future__ import annotations

import importlib.util
import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor

from minivla import ClipDataset, Dataset, Episode, FrameDataset, SceneSampler
from schemas.encoding.digest import frame_digest


def digest_of(episode: Episode, t: int) -> str:
    return frame_digest(*episode.frame(t))


def main() -> None:
    dataset = Dataset(sys.argv[1])
    episode = dataset[0]
    recorded = episode.meta.frame_digests[0]
    assert digest_of(episode, 0) == recorded
    for method in ("fork", "spawn"):
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context(method)) as pool:
            assert pool.submit(digest_of, episode, 0).result() == recorded
    frames = FrameDataset(dataset, size=64, antialias=2, with_ids=True, threads=4)
    batch = frames.__getitems__(list(SceneSampler(frames))[:8])
    assert batch.images["rgb"].shape == (8, 64, 64, 3)
    assert ClipDataset(dataset, 4, stride=3, size=32)[0]["depth"].shape == (4, 32, 32)
    missing = [name for name in ("pybullet", "zenoh", "sqlalchemy", "torch") if importlib.util.find_spec(name) is None]
    print(f"rendered {len(frames)} frames without {', '.join(missing)}")  # noqa: T201


if __name__ == "__main__":
    main()
