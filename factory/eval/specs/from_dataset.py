"""Creates evaluation specs from the archived episodes of a dataset, with the same starts and targets. Reads only."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from factory.dataset.episode import Episode
from factory.dataset.packages import light_file
from factory.dataset.reader import Dataset
from factory.eval.models.spec import EvalSettings, EvalSpec, SpecSet, spread
from factory.runs.scene_packages import find_package
from schemas.appearance.light_groups import decode_light_groups
from schemas.episode import EpisodeMeta
from schemas.episode_spec import EpisodeSpec
from schemas.errors import UsageError
from schemas.instruction.referents import ids_in_view
from schemas.measure import Goal
from schemas.scene import Instance, read_scene
from schemas.storage.place import Place
from schemas.support.shell import quoted
from schemas.terms import Split
from workers.geometry.pose import Pose
from workers.sim.context import LoadedScene, prepare_scene
from workers.sim.spawn import draw_poses

TRAINED_ON = (Split.TRAIN_ID, Split.VAL_ID)
"""Splits for training and for the selection of a checkpoint; all others are test splits."""
_SAME_PLACE_M = 0.005
"""Maximum distance at which a redrawn pose counts as the recorded one, metres; the warm-up moves the robot a little."""
_SAME_HEADING_RAD = 0.01

ProgressCallback = Callable[[int, int], None]
"""Called with finished and total episodes."""


class LoadedScenes:
    """Cache of the scenes of a dataset, loaded on demand; keeps the most recent ones."""

    def __init__(self, root: Place, keep: int = 4) -> None:
        self._root = root
        self._keep = keep
        self._paths: dict[str, Path] = {}
        self._loaded: dict[str, LoadedScene] = {}

    def path(self, name: str, sha256: str) -> Path:
        """Returns the package file of a scene; raises `ArchiveCorrupt` if the dataset does not have it."""
        if sha256 not in self._paths:
            self._paths[sha256] = find_package(self._root, name, sha256).path
        return self._paths[sha256]

    def load(self, name: str, sha256: str, with_light: bool = False) -> LoadedScene:
        """Returns a loaded scene, with its light groups if wanted; raises `ArchiveCorrupt` if the dataset lacks it."""
        if sha256 not in self._loaded:
            self._loaded[sha256] = prepare_scene(read_scene(self.path(name, sha256)))
        if with_light and self._loaded[sha256].light is None:
            with light_file(self.path(name, sha256), sha256).open("rb") as file:
                self._loaded[sha256] = replace(self._loaded[sha256], light=decode_light_groups(file))
        while len(self._loaded) > self._keep:
            del self._loaded[next(iter(self._loaded))]
        return self._loaded[sha256]


def splits_of(dataset: Dataset, names: tuple[str, ...] | None) -> tuple[Split, ...]:
    """Returns the splits to evaluate, in the paper's order.

    Args:
        dataset: the dataset.
        names: names of splits; empty for all splits with episodes, `None` for all test splits with episodes.
    """
    if names:
        return tuple(split for split in Split if str(split) in names)
    present = set(dataset.column("split").to_pylist())
    splits = tuple(split for split in Split if str(split) in present and (names is not None or split not in TRAINED_ON))
    if not present:
        raise UsageError(
            f"{dataset.root} has no episodes: `factory status {quoted(dataset.root)}` shows its run, "
            f"`factory run --out {quoted(dataset.root)}` continues it"
        )
    if not splits:
        raise UsageError(
            f"{dataset.root} has no episodes in test splits; evaluate on its other splits with --split all"
        )
    return splits


def specs_of_dataset(
    dataset: Dataset,
    splits: Collection[Split],
    tell: ProgressCallback = lambda _done, _total: None,
    episodes: int | None = None,
) -> SpecSet:
    """Returns one spec for each archived episode of some splits, in the order of the plan.

    Args:
        dataset: Dataset with its scenes and episodes.
        splits: Splits; each must have episodes.
        tell: Progress callback.
        episodes: Maximum number of episodes, spread evenly over the list.

    Raises:
        UsageError: A split has no episodes.
        ArchiveCorrupt: An episode or a scene is missing or damaged.
    """
    _require_episodes(dataset, splits)
    part = dataset.filter(split=[str(split) for split in splits])
    names = part.column("episode_id").to_pylist()
    chosen = [names[place] for place in spread(len(names), episodes)]
    source = f"episodes of {dataset.meta.run}, splits {', '.join(str(split) for split in splits)}"
    places = LoadedScenes(dataset.root)
    specs: dict[str, EvalSpec] = {}
    # process by scene and target, to reuse derived data; the returned specs have the order of the plan
    order = sorted(
        (part[name] for name in chosen), key=lambda episode: (episode.summary.scene, episode.summary.target_id)
    )
    for done, episode in enumerate(order, 1):
        with episode:
            specs[episode.episode_id] = spec_of_episode(episode, places)
        tell(done, len(chosen))
    return SpecSet(
        source=source if len(chosen) == len(names) else f"{source}; {len(chosen)} of {len(names)}",
        run=dataset.meta.run,
        settings=EvalSettings.of(dataset.meta.plan),
        specs=tuple(specs[name] for name in chosen),
    )


def spec_of_episode(episode: Episode, places: LoadedScenes) -> EvalSpec:
    meta, job = episode.meta, episode.meta.job
    drawn = _drawn_pose(meta, places.load(job.scene, job.scene_sha256))
    seen = categories_in_view(episode.ids(0), episode.instances, job.gains.min_mask_px)
    target_pixels = int(np.count_nonzero(episode.ids(0) == meta.target_instance_id))
    return EvalSpec(
        spec_id=episode.episode_id,
        **dict(EpisodeSpec.of(job, instruction=meta.instruction, template_id=meta.template_id)),
        scene_sha256=job.scene_sha256,
        seed=int(np.random.SeedSequence((job.root_seed, job.index)).generate_state(1)[0]),
        spawn_pose=drawn or meta.rollout.spawn_pose,
        spawn_source="job" if drawn else "frame",
        spawn_dist_m=Goal.of_episode(meta).distance(*meta.rollout.spawn_pose[:2]),
        geodesic_m=meta.route.geodesic_m,
        categories_in_view=seen,
        is_target_in_view=target_pixels >= job.gains.min_mask_px,
        source_episode=episode.episode_id,
    )


def categories_in_view(ids: NDArray[np.uint16], instances: Sequence[Instance], min_pixels: int) -> tuple[str, ...]:
    """Returns the categories with at least one object in view, sorted by name.

    Args:
        ids: (H, W) instance ids.
        instances: Instances of the ids.
        min_pixels: Minimum number of pixels of an object in view.
    """
    in_view = ids_in_view(ids, min_pixels)
    return tuple(sorted({each.category for each in instances if each.category is not None and each.id in in_view}))


def _require_episodes(dataset: Dataset, splits: Collection[Split]) -> None:
    present = set(dataset.column("split").to_pylist())
    empty = [str(split) for split in splits if str(split) not in present]
    if empty:
        there = ", ".join(sorted(present)) or "none"
        raise UsageError(f"{dataset.root} has no episodes in {', '.join(empty)}; splits with episodes: {there}")


def _drawn_pose(meta: EpisodeMeta, scene: LoadedScene) -> tuple[float, float, float] | None:
    """Redraws the start pose of the attempt; returns `None` if this version draws another pose."""
    target = scene.compiled.info.target(meta.job.target_id)
    x, y, yaw = meta.rollout.spawn_pose

    def is_recorded(pose: Pose) -> bool:
        is_here = math.hypot(pose.x - x, pose.y - y) <= _SAME_PLACE_M
        return is_here and abs(math.remainder(pose.yaw - yaw, 2 * math.pi)) <= _SAME_HEADING_RAD

    # instead of the check of the start view, which would render the view, compare with the recorded pose
    accepts = is_recorded if meta.job.start_view else (lambda _pose: True)
    draws = draw_poses(meta.job, target, scene=scene, rng=meta.job.rng(), accepts=accepts)
    drawn = next(filter(is_recorded, draws), None)
    return None if drawn is None else (drawn.x, drawn.y, drawn.yaw)
