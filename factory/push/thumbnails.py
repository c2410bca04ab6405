"""Renders the thumbnails of a states dataset into its split tables, which the viewer of the Hub shows."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coordinator.archive.directory import DirectoryArchive
from coordinator.tables.split_tables import has_pictures, lacks_pictures, write_split_tables
from factory.dataset.reader import Dataset
from schemas.storage.dataset_files import META_FILE, SPLITS_FOLDER
from schemas.storage.place import children

ProgressCallback = Callable[[int, int], None]


def lacks_thumbnails(root: Path) -> bool:
    """Returns whether a folder is a states dataset whose split tables have rows without thumbnails."""
    if not (root / META_FILE).is_file() or has_pictures(root):
        return False
    return any(lacks_pictures(table) for table in children(root / SPLITS_FOLDER))


def render_thumbnails(root: Path, tell: ProgressCallback) -> None:
    """Renders the missing thumbnails of a states dataset. They equal the thumbnails of a frames dataset.

    Args:
        root: Dataset directory.
        tell: Progress callback, called with the number of rendered thumbnails and the number of episodes.

    Raises:
        WorldError: A coordinator has locked the dataset, it cannot be written, or this machine cannot render.
        ArchiveCorrupt: A table, an episode or a scene is damaged.
    """
    # not at the end of a run, because the machine of a coordinator may have no graphics driver
    dataset, done = Dataset(root), count(1)

    def draw(episode_id: str) -> NDArray[np.uint8]:
        with dataset[episode_id] as episode:
            rgb = episode.rgb(0)
        tell(next(done), len(dataset))
        return rgb

    with DirectoryArchive(root) as archive:
        write_split_tables(archive, draw=draw)
