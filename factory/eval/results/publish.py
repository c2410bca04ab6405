"""Writes the results of an evaluation: results.json, episodes.parquet and the page. Runs no episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from factory.dataset.reader import Dataset
from factory.eval.models.result import REAL, EpisodeResult, Variant
from factory.eval.models.spec import EvalSpec
from factory.eval.policies.registry import PolicyNote
from factory.eval.results.estimate import FEW
from factory.eval.results.page import FailureExample, write_page
from factory.eval.results.score import EvalLimits, Evaluation, TrainingOverlap, score_policy
from factory.eval.results.store import Store
from factory.eval.results.video import FILM_CRF, FILM_RATE, choose_failures, draw_frames, draw_poster
from factory.eval.specs.campaign import Campaign
from factory.eval.specs.from_dataset import TRAINED_ON, LoadedScenes
from factory.visualize.film import write_mp4
from schemas.errors import WorldError
from schemas.storage.disk import replacing
from schemas.view import ViewSettings
from workers.sim.context import SimulationContext

RESULTS_FILE, TABLE_FILE, PAGE_FILE = "results.json", "episodes.parquet", "index.html"
VIDEOS = "videos"
"""Name of the folder of videos in the folder of a policy. A video is `SPEC.mp4`; `SPEC.jpg` is its last picture."""

ProgressCallback = Callable[[int, int], None]
"""Called with the number of finished videos and the total."""


def publish(
    campaign: Campaign, store: Store, videos: int, tell: ProgressCallback = lambda _done, _total: None
) -> Evaluation:
    """Writes all results of an evaluation and returns them.

    Args:
        campaign: Evaluated campaign.
        store: Store of the finished episodes.
        videos: Number of failures of each policy to show on the page.
        tell: Progress callback of the videos.

    Raises:
        WorldError: The directory cannot be written.
    """
    evaluation = evaluation_of(campaign, store)
    _write(store.root / RESULTS_FILE, (evaluation.model_dump_json(indent=1) + "\n").encode())
    rows = [row for name in campaign.policies for row in store.results(name)]
    with replacing(store.root / TABLE_FILE) as part:
        pq.write_table(pa.Table.from_pylist([_flat(row) for row in rows]), part)
    page = write_page(evaluation, _failures(campaign, store, videos, tell))
    _write(store.root / PAGE_FILE, page.encode())
    return evaluation


def _failures(campaign: Campaign, store: Store, videos: int, tell: ProgressCallback) -> dict[str, list[FailureExample]]:
    """Returns policy name -> failed episodes with their videos; draws a video only if its file does not exist."""
    chosen = {
        name: choose_failures([row for row in store.results(name) if row.variant is Variant.ORIGINAL], videos)
        for name in campaign.policies
    }
    total = sum(len(rows) for rows in chosen.values())
    if total == 0:
        return {}
    shas = {spec.scene: spec.scene_sha256 for spec in campaign.specs.specs}
    settings, places = campaign.specs.settings, LoadedScenes(campaign.root)
    failures: dict[str, list[FailureExample]] = {name: [] for name in chosen}
    with SimulationContext(campaign.setup.renderer) as stage:
        for name, rows in chosen.items():
            folder = store.folder(name) / VIDEOS
            folder.mkdir(exist_ok=True)
            for row in rows:
                film, poster = folder / f"{row.spec_id}.mp4", folder / f"{row.spec_id}.jpg"
                if not (film.exists() and poster.exists()):
                    scene = places.load(row.scene, shas[row.scene]).compiled
                    pictures = list(
                        draw_frames(row, scene, task=settings.task, renderer=stage.renderer, camera=settings.camera)
                    )
                    _write(poster, draw_poster(pictures[-1]))
                    write_mp4(film, pictures, FILM_RATE, FILM_CRF)
                failures[name].append(FailureExample(row, film.read_bytes(), poster.read_bytes()))
                tell(sum(map(len, failures.values())), total)
    return failures


def evaluation_of(campaign: Campaign, store: Store) -> Evaluation:
    """Returns the tables of the finished episodes."""
    scores = []
    is_complete = True
    for name in campaign.policies:
        results = [row for row in store.results(name) if row.variant in campaign.variants]
        note = store.note_of(name)
        if note is None:
            raise WorldError(f"{store.root} has no description of policy {name}; run the same command again")
        expected = len(campaign.specs.specs) * (len(campaign.variants) if note.reads_instruction else 1)
        is_complete = is_complete and len(results) >= expected
        overlap = training_overlap(campaign, note, [row for row in results if row.variant is Variant.ORIGINAL])
        scores.append(score_policy(name, results, note).model_copy(update={"training": overlap}))
    return Evaluation(
        run=campaign.specs.run,
        source=campaign.specs.source,
        specs_digest=campaign.specs.digest,
        episodes=len(campaign.specs.specs),
        success=campaign.specs.settings.task.success,
        success_radius_m=campaign.specs.settings.task.success_radius_m,
        limits=EvalLimits(
            max_steps=campaign.specs.settings.task.max_steps,
            control_hz=campaign.specs.settings.task.control_hz,
            act_timeout_s=campaign.setup.act_timeout_s,
            load_timeout_s=campaign.setup.load_timeout_s,
        ),
        latency=campaign.setup.latency,
        view=campaign.setup.view,
        complete=is_complete,
        policies=tuple(scores),
        remarks=(*_order_dependences(campaign, store), *_remarks(campaign)),
    )


def training_overlap(campaign: Campaign, note: PolicyNote, results: Sequence[EpisodeResult]) -> TrainingOverlap | None:
    """Returns how many of the evaluated episodes a policy was trained on; `None` if its training is not known.

    Args:
        campaign: Evaluated campaign.
        note: Metadata of the policy, with its training.
        results: Results of the policy with the original instructions.
    """
    training, dataset = note.training, Dataset(campaign.root)
    if training is None:
        return None
    specs = campaign.specs.specs
    known = set(dataset.column("episode_id").to_pylist()) if dataset.meta.run == campaign.specs.run else set()
    names = [spec.source_episode for spec in specs if spec.source_episode in known]
    flags = [row.trained_on for row in results if row.trained_on is not None]
    # a checkpoint of format 2 has a digest only, which equals that of a whole split of the dataset, or is unknown
    trained_on = sum(flags) if flags else _in_trained_split(dataset, training.digest, specs, known)
    return TrainingOverlap(
        train_digest=training.digest,
        train_episodes=training.episodes,
        evaluation_digest=dataset.filter(episode=[name for name in names if name]).digest if names else None,
        episodes=len(specs),
        trained_on=trained_on,
    )


def _in_trained_split(dataset: Dataset, digest: str, specs: Sequence[EvalSpec], known: set[str]) -> int | None:
    """Returns the number of specs from the split of the dataset with this digest; `None` without such a split."""
    for split in sorted(set(dataset.column("split").to_pylist())):
        if dataset.filter(split=split).digest == digest:
            return len([spec for spec in specs if str(spec.split) == split and spec.source_episode in known])
    return None


def _order_dependences(campaign: Campaign, store: Store) -> Iterator[str]:
    for name in campaign.policies:
        note = store.note_of(name)
        if note is not None and note.order_dependence is not None:
            yield f"warning: {note.order_dependence}"


def _remarks(campaign: Campaign) -> list[str]:
    specs = campaign.specs.specs
    moved = sum(spec.spawn_source == "frame" for spec in specs)
    ways = sum(spec.geodesic_m is None for spec in specs)
    remarks = []
    if len(specs) < FEW:
        remarks.append(f"{len(specs)} episodes are few, so the intervals are wide; evaluate at least {FEW}")
    counts = Counter(spec.split for spec in specs)
    if trained := [f"{counts[split]} of {split}" for split in TRAINED_ON if counts[split]]:
        remarks.append(
            f"{' and '.join(trained)} are among the {len(specs)} episodes: a policy that was trained or selected on "
            "this dataset knows them; the default is the test splits only"
        )
    if (latency := campaign.setup.latency) is not None:
        taken = "the measured time, so these results are not reproducible" if latency == REAL else f"{latency:g} ms"
        remarks.append(
            f"latency: each answer of a policy after the first of an episode takes {taken}; the robot keeps its former "
            "command meanwhile. Results with another latency are not comparable"
        )
    if campaign.setup.view != ViewSettings():
        remarks.append(f"view of the policies: {campaign.setup.view.describe()}")
    if moved:
        remarks.append(
            f"{moved} of {len(specs)} episodes start at the recorded pose of frame 0, and not at the start that their "
            "job gives, because another version of the software collected them; `replay` can fail in them"
        )
    if ways:
        remarks.append(f"{ways} of {len(specs)} episodes have no path on the floor and are excluded from SPL")
    if Variant.WRONG in campaign.variants:
        remarks.append("policies that do not use the instruction are not evaluated with other instructions")
    return remarks


def _write(path: Path, data: bytes) -> None:
    with replacing(path) as part:
        part.write_bytes(data)


def _flat(row: EpisodeResult) -> dict[str, object]:
    """Returns the row with its track as three list columns."""
    data = row.model_dump(mode="json", exclude={"track"}) | {"oracle_success": row.oracle_success}
    for number, name in enumerate(("track_x_m", "track_y_m", "track_yaw_rad")):
        data[name] = [pose[number] for pose in row.track]
    return data
