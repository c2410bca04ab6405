"""Reads the first and the last frames of a dataset's episodes for the language statistics. Computes no statistics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from types import MappingProxyType

from factory.dataset.columns import read_table
from factory.dataset.episode import Episode
from factory.dataset.packages import find_package_file
from factory.stats.language import EpisodeView, summarise_language
from factory.stats.rows import MOST_OPENED, Rows, format_error, read_rows, spread_evenly
from factory.stats.statistics import LanguageStatistics
from schemas.dataset.rows import file_name_of
from schemas.episode import EpisodeMeta
from schemas.errors import ArchiveCorrupt, InvalidBundle
from schemas.instruction.referents import referents, referents_of
from schemas.instruction.start_view import see_objects
from schemas.measure import target_in_view
from schemas.scene import SceneInfo, read_info
from schemas.storage.dataset_files import EPISODES, INSTRUCTIONS_FILE, SCENES
from schemas.storage.place import Place
from schemas.storage.shard_index import episode_place

ProgressCallback = Callable[[int, int], None]


def measure_language(root: Place, on_progress: ProgressCallback = lambda _done, _all: None) -> LanguageStatistics:
    """Returns the language statistics of a dataset; reads two frames of at most `MOST_OPENED` episodes.

    Args:
        root: Directory or URL of the dataset.
        on_progress: Callback with the number of episodes read and the total.

    Raises:
        WorldError: The dataset does not exist, or its format is newer than this software.
        ArchiveCorrupt: `dataset_meta.json` or the table of episodes cannot be read.
    """
    # from frames, because the tables of older datasets have no columns for this
    rows = read_rows(root)
    rewritten = read_rewritten(root)
    chosen = spread_evenly(rows.episodes, MOST_OPENED) if (root / EPISODES).is_dir() else []
    infos = _read_infos(root, rows, {row.scene for row in chosen})
    views = []
    for done, row in enumerate(chosen, 1):
        name = file_name_of(row.episode_id)
        with Episode(episode_place(root, row.index), row) as episode:
            try:
                view = read_view(episode, infos, rewritten)
            except ArchiveCorrupt as error:
                rows.add_damage(name, f"skipped: {format_error(error, root)}")
            else:
                views += [view] if view else []
        on_progress(done, len(chosen))
    scenes = [scene.name for scene in rows.meta.plan.scenes]
    return summarise_language(
        str(root),
        rows.meta.run,
        scenes=scenes,
        episodes=len(rows.episodes),
        views=views,
        remarks=rows.remarks,
        spec=None if rewritten else rows.meta.plan.language,
    )


@dataclass(frozen=True)
class RewrittenText:
    """New instruction of a relabelled episode."""

    fits: int
    """Number of objects that it fits."""
    features: frozenset[str]
    """Features of the expression."""


def read_rewritten(root: Place) -> dict[str, RewrittenText]:
    """Returns episode id -> new instruction; empty if the dataset is not relabelled."""
    if not (root / INSTRUCTIONS_FILE).is_file():
        return {}
    rows = read_table(root / INSTRUCTIONS_FILE, ("episode_id", "number", "fits", "features")).to_pylist()
    return {
        row["episode_id"]: RewrittenText(row["fits"], frozenset(filter(None, (row["features"] or "").split(","))))
        for row in rows
        if row["number"] == 1 and row["fits"] is not None
    }


def read_view(
    episode: Episode, infos: Mapping[str, SceneInfo], rewritten: Mapping[str, RewrittenText] = MappingProxyType({})
) -> EpisodeView | None:
    """Returns the objects in view of an episode, or `None` if its scene is missing.

    Args:
        episode: Episode of the dataset.
        infos: SHA-256 of a scene package -> metadata of the scene.
        rewritten: New instructions of a relabelled dataset, by episode.

    Raises:
        ArchiveCorrupt: The episode is missing or damaged.
    """
    meta, info = episode.meta, infos.get(episode.summary.scene_sha256)
    if info is None:
        return None
    new, written = rewritten.get(episode.episode_id), meta.language
    features = new.features if new is not None else None if written is None else written.named_features
    target, min_pixels = meta.target_instance_id, meta.job.gains.min_mask_px
    objects = {instance.id for instance in info.instances if instance.category is not None}
    return EpisodeView(
        row=episode.summary,
        target=target,
        of_category=referents(info, meta.job.category),
        fitting=_fitting(meta, info, None if new is None else new.fits),
        seen=see_objects(
            episode.ids(0), episode.depth(0), objects=objects, camera=meta.job.camera, min_pixels=min_pixels
        ),
        is_in_view_at_end=target_in_view(episode.ids(-1), target, min_pixels),
        choices=frozenset(meta.choices),
        features=features,
    )


def _fitting(meta: EpisodeMeta, info: SceneInfo, fits: int | None) -> frozenset[int]:
    """Returns the objects that an instruction fits.

    For a verified instruction, only the number of objects is recorded: 0 means no object, 1 the target, and a larger
    number is treated as all objects of the category.
    """
    if fits is None and meta.language is not None:
        fits = meta.language.fits
    if fits is None:
        return referents_of(meta.job, info)
    known = {0: frozenset[int](), 1: frozenset({meta.target_instance_id})}
    return known.get(fits, referents(info, meta.job.category))


def _read_infos(root: Place, rows: Rows, opened: Set[str]) -> dict[str, SceneInfo]:
    infos = {}
    for name, sha256 in rows.meta.scenes.items():
        if name not in opened:
            continue
        try:
            infos[sha256] = read_info(find_package_file(root, name, sha256))
        except (ArchiveCorrupt, InvalidBundle, OSError) as error:
            rows.add_damage(SCENES, f"the episodes of {name} are skipped: {format_error(error, root)}")
    return infos
