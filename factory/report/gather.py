"""Reads the input of a report from a dataset. Omits unreadable episodes and scenes with a remark."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.report.data import Drives, FrameSample, ReportInput, mapped_scenes
from factory.runs.scene_packages import find_package
from factory.stats import compute_statistics
from factory.stats.rollouts import by_measure
from factory.stats.rows import MOST_OPENED, Rows, format_error, read_rows, spread_evenly
from factory.stats.views import RewrittenText, read_rewritten, read_view
from factory.visualize.floor_map import FloorMap, map_of
from schemas.dataset.rows import EpisodeSummary, file_name_of
from schemas.errors import ArchiveCorrupt, InvalidBundle
from schemas.scene import SceneInfo, read_geometry
from schemas.storage.dataset_files import EPISODES, SCENES
from schemas.storage.place import Place
from schemas.storage.shard_index import episode_place

ProgressCallback = Callable[[int, int], None]
_TRACK_POINTS = 48
"""Maximum number of points of a thinned track; they are enough to show the turns of the robot."""
_FRAMES_TRIED = 6
_SHARE_WANTED = 0.08
"""Preferred share of a sample frame that the target covers, 0..1."""


def gather(
    root: Place,
    on_progress: ProgressCallback = lambda _done, _all: None,
    samples: int = 8,
    compare_paper: bool | None = None,
    most_opened: int = MOST_OPENED,
) -> ReportInput:
    """Reads the input of the report of a dataset.

    Args:
        root: root of the dataset.
        on_progress: callback with the number of episodes read and the total.
        samples: number of sample frames.
        compare_paper: see `measure_dataset`.
        most_opened: number of episodes that are opened for tracks, actions and objects in view.

    Raises:
        WorldError: the dataset does not exist or has a newer format.
        ArchiveCorrupt: the metadata or the table of episodes cannot be read.
    """
    rows = read_rows(root)
    chosen: list[EpisodeSummary] = []
    rewritten = read_rewritten(root)
    if (root / EPISODES).is_dir():
        shown = {row.episode_id for row in choose_samples(rows.episodes, samples)}
        opened = shown | {row.episode_id for row in spread_evenly(rows.episodes, most_opened)}
        chosen = [row for row in rows.episodes if row.episode_id in opened]
    maps, infos = _read_scenes(root, rows, {row.scene for row in chosen})
    drives = Drives()
    if chosen:
        # sorted by scene, so each scene is prepared only once
        for done, row in enumerate(sorted(chosen, key=lambda row: row.scene_sha256), 1):
            _read_drive(
                root, row, is_sample=row.episode_id in shown, infos=infos, rewritten=rewritten, drives=drives, rows=rows
            )
            on_progress(done, len(chosen))
        drives.views.sort(key=lambda view: view.row.index)
        drives.samples.sort(key=lambda sample: sample.row.index)
    statistics = compute_statistics(rows.meta.run, rows, compare_paper)
    episodes = by_measure(rows.episodes, rows.meta.plan.task.success)
    return ReportInput(rows.meta, statistics, episodes=episodes, failures=rows.failures, drives=drives, maps=maps)


def _read_drive(
    root: Place,
    row: EpisodeSummary,
    is_sample: bool,
    infos: Mapping[str, SceneInfo],
    rewritten: Mapping[str, RewrittenText],
    drives: Drives,
    rows: Rows,
) -> None:
    name = file_name_of(row.episode_id)
    with Episode(episode_place(root, row.index), row) as episode:
        try:
            tokens, track = episode.tokens, _thin(episode.poses[:, :2])
        except ArchiveCorrupt as error:
            rows.add_damage(name, f"skipped in trajectories, actions and frames: {format_error(error, root)}")
            return
        np.add.at(drives.tokens, (tokens[:, 0], tokens[:, 1]), 1)
        drives.tracks[row.episode_id] = track
        try:
            view = read_view(episode, infos, rewritten)
            samples = [_best_frame(episode)] if is_sample else []
        except ArchiveCorrupt as error:
            rows.add_damage(name, f"skipped in the frames and the instructions: {format_error(error, root)}")
            return
        drives.views += [view] if view else []
        drives.samples += samples


def _thin(track: NDArray[np.float64]) -> NDArray[np.float64]:
    chosen = np.unique(np.linspace(0, len(track) - 1, min(len(track), _TRACK_POINTS)).round().astype(int))
    thinned: NDArray[np.float64] = track[chosen]
    return thinned


def _best_frame(episode: Episode) -> FrameSample:
    """Samples frames evenly; returns the one whose share of target pixels is nearest to `_SHARE_WANTED`."""
    target = episode.meta.target_instance_id
    steps = np.unique(np.linspace(0, len(episode) - 1, _FRAMES_TRIED).round().astype(int))
    masks = {int(t): episode.ids(int(t)) == target for t in steps}
    t = min(masks, key=lambda step: abs(float(masks[step].mean()) - _SHARE_WANTED))
    return FrameSample(episode.summary, t, episode.rgb(t), masks[t])


def _read_scenes(root: Place, rows: Rows, opened: Set[str]) -> tuple[dict[str, FloorMap], dict[str, SceneInfo]]:
    """Returns the maps by scene name, and the metadata by SHA-256 of the package.

    Reads the scenes that the report shows as maps and, for their metadata only, the other scenes in `opened`.
    """
    mapped = set(mapped_scenes(rows.meta.plan))
    maps: dict[str, FloorMap] = {}
    infos: dict[str, SceneInfo] = {}
    for name, sha256 in rows.meta.scenes.items():
        if name not in mapped | opened:
            continue
        try:
            scene = read_geometry(find_package(root, name, sha256).path)
        except (ArchiveCorrupt, InvalidBundle, OSError) as error:
            text = f"no map of {name}, and no language statistics of its episodes: {format_error(error, root)}"
            rows.add_damage(SCENES, text)
        else:
            infos[sha256] = scene.info
            if name in mapped:
                maps[name] = map_of(scene)
    return maps, infos


def choose_samples(episodes: Sequence[EpisodeSummary], count: int) -> list[EpisodeSummary]:
    """Returns up to `count` episodes, alternating between scenes, and within a scene between categories.

    Within a category, the episode whose target is visible for the largest share of the steps is chosen first; if
    several shares are equal, the episode with the smallest index. The result depends on the rows only.
    """
    scenes = dict.fromkeys(row.scene for row in episodes)
    queues = [_in_turn([row for row in episodes if row.scene == scene]) for scene in scenes]
    mixed = [row for turn in zip_longest(*queues) for row in turn if row is not None]
    return sorted(mixed[:count], key=lambda row: (list(scenes).index(row.scene), row.index))


def _in_turn(episodes: Sequence[EpisodeSummary]) -> list[EpisodeSummary]:
    """Returns the best episode of each category, then the second best of each category, and so on."""
    by_category: dict[str, list[EpisodeSummary]] = {}
    for row in episodes:
        by_category.setdefault(row.target_category, []).append(row)
    ranked = [
        sorted(rows, key=lambda row: (-(row.steps_visible or 0) / row.num_steps, row.index))
        for rows in by_category.values()
    ]
    return [row for turn in zip_longest(*ranked) for row in turn if row is not None]
