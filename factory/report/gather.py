"""Reads the input of a report from a dataset. Omits unreadable episodes and scenes with a remark. Draws nothing."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.report.data import Drives, FloorMap, FrameSample, ReportInput
from factory.report.floor_map import map_of
from factory.runs.catalog import find_package
from factory.stats import compute_statistics
from factory.stats.rows import Rows, read_rows
from schemas.dataset import EpisodeSummary, file_name_of
from schemas.dataset_files import EPISODES, SCENES
from schemas.errors import ArchiveCorrupt, InvalidBundle
from schemas.scene import decode_scene
from schemas.storage.place import Place

__all__ = ["choose_samples", "gather", "spread_evenly"]

ProgressCallback = Callable[[int, int], None]
_MOST_DRIVES = 2000
"""Maximum number of episodes opened for tracks and actions; the statistics use all rows."""
_TRACK_POINTS = 48
"""Number of points of a thinned track; it resolves the turns of the robot."""
_FRAMES_TRIED = 6
_SHARE_WANTED = 0.08
"""Preferred share of the frame that the target covers, 0..1."""


def gather(
    root: Place,
    on_progress: ProgressCallback = lambda _done, _all: None,
    samples: int = 8,
    compare_paper: bool | None = None,
) -> ReportInput:
    """Reads the input of the report of a dataset.

    Args:
        root: root of the dataset.
        on_progress: callback with the number of episodes read and the total.
        samples: number of sample frames.
        compare_paper: see `measure_dataset`.

    Raises:
        WorldError: the dataset does not exist or has a newer format.
        ArchiveCorrupt: the metadata or the table of episodes cannot be read.
    """
    rows = read_rows(root)
    maps = _read_maps(root, rows)
    drives = Drives()
    if (root / EPISODES).is_dir():
        shown = {row.episode_id for row in choose_samples(rows.episodes, samples)}
        opened = shown | {row.episode_id for row in spread_evenly(rows.episodes, _MOST_DRIVES)}
        chosen = [row for row in rows.episodes if row.episode_id in opened]
        for done, row in enumerate(chosen, 1):
            _read_drive(root, row, row.episode_id in shown, drives, rows)
            on_progress(done, len(chosen))
    statistics = compute_statistics(rows.meta.run, rows, compare_paper)
    return ReportInput(rows.meta, statistics, rows.episodes, rows.failures, drives, maps)


def _read_drive(root: Place, row: EpisodeSummary, is_sample: bool, drives: Drives, rows: Rows) -> None:
    name = file_name_of(row.episode_id)
    with Episode(root / name, row) as episode:
        try:
            tokens, track = episode.tokens, _thin(episode.poses[:, :2])
        except ArchiveCorrupt as error:
            rows.add_damage(name, f"skipped in trajectories, actions and frames: {_format_error(error, root)}")
            return
        np.add.at(drives.tokens, (tokens[:, 0], tokens[:, 1]), 1)
        drives.tracks[row.episode_id] = track
        if is_sample:
            _read_sample(episode, name, drives, rows, root)


def _read_sample(episode: Episode, name: str, drives: Drives, rows: Rows, root: Place) -> None:
    try:
        drives.samples.append(_best_frame(episode))
    except ArchiveCorrupt as error:
        rows.add_damage(name, f"skipped in the sample frames: {_format_error(error, root)}")


def _thin(track: NDArray[np.float64]) -> NDArray[np.float64]:
    chosen = np.unique(np.linspace(0, len(track) - 1, min(len(track), _TRACK_POINTS)).round().astype(int))
    thinned: NDArray[np.float64] = track[chosen]
    return thinned


def _best_frame(episode: Episode) -> FrameSample:
    """Returns the frame, among several spread over the episode, whose target size is nearest to the preferred share."""
    target = episode.meta.target_instance_id
    steps = np.unique(np.linspace(0, len(episode) - 1, _FRAMES_TRIED).round().astype(int))
    masks = {int(t): episode.ids(int(t)) == target for t in steps}
    t = min(masks, key=lambda step: abs(float(masks[step].mean()) - _SHARE_WANTED))
    return FrameSample(episode.summary, t, episode.rgb(t), masks[t])


def _read_maps(root: Place, rows: Rows) -> dict[str, FloorMap]:
    found: dict[str, FloorMap] = {}
    for name, sha256 in rows.meta.scenes.items():
        try:
            with find_package(root, name, sha256).path.open("rb") as file:
                found[name] = map_of(decode_scene(file))
        except (ArchiveCorrupt, InvalidBundle, OSError) as error:
            rows.add_damage(SCENES, f"the map of {name} is missing: {_format_error(error, root)}")
    return found


def _format_error(error: Exception, root: Place) -> str:
    """Returns an error message on one line with paths relative to the dataset, so that pages are reproducible."""
    return " ".join(str(error).replace(f"{root}/", "").split())


def choose_samples(episodes: Sequence[EpisodeSummary], count: int) -> list[EpisodeSummary]:
    """Returns up to `count` episodes, alternating between scenes, and within a scene between categories.

    Within a category, it chooses the episode whose target is visible for the largest share of the steps, then the
    first. The result depends on the rows only.
    """
    scenes = dict.fromkeys(row.scene for row in episodes)
    queues = [_in_turn([row for row in episodes if row.scene == scene]) for scene in scenes]
    mixed = [row for turn in zip_longest(*queues) for row in turn if row is not None]
    return sorted(mixed[:count], key=lambda row: (list(scenes).index(row.scene), row.index))


def spread_evenly(episodes: Sequence[EpisodeSummary], count: int) -> list[EpisodeSummary]:
    """Returns all episodes, or `count` of them evenly spaced from the first to the last."""
    if len(episodes) <= count:
        return list(episodes)
    return [episodes[place * (len(episodes) - 1) // max(count - 1, 1)] for place in range(count)]


def _in_turn(episodes: Sequence[EpisodeSummary]) -> list[EpisodeSummary]:
    """Returns the best episode of each category, then the second of each, and so on."""
    by_category: dict[str, list[EpisodeSummary]] = {}
    for row in episodes:
        by_category.setdefault(row.target_category, []).append(row)
    ranked = [
        sorted(rows, key=lambda row: (-(row.steps_visible or 0) / row.num_steps, row.index))
        for rows in by_category.values()
    ]
    return [row for turn in zip_longest(*ranked) for row in turn if row is not None]
