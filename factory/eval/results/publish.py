"""Writes the results of an evaluation: results.json, episodes.parquet and the page. Runs no episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from factory.dataset.reader import Dataset
from factory.eval.models.result import REAL, EpisodeResult, Variant
from factory.eval.models.spec import EvalSpec, SpecSet
from factory.eval.policies.registry import PolicyNote
from factory.eval.results.compare import PairedComparison, choose_different, compare_all, pairs_of, require_common
from factory.eval.results.estimate import FEW
from factory.eval.results.page import EpisodeFilm, Names, write_comparison_page, write_page
from factory.eval.results.score import EvalLimits, Evaluation, TrainingOverlap, score_policy
from factory.eval.results.store import PolicyResults, Store, folder_name
from factory.eval.results.video import FILM_CRF, FILM_RATE, choose_failures, draw_frames, draw_pair, draw_poster
from factory.eval.specs.campaign import Campaign
from factory.eval.specs.from_dataset import TRAINED_ON, LoadedScenes
from factory.visualize.film import write_mp4
from schemas.errors import WorldError
from schemas.storage.disk import replacing
from schemas.terms import RendererKind
from schemas.view import ViewSettings
from workers.sim.context import SimulationContext

RESULTS_FILE, TABLE_FILE, PAGE_FILE = "results.json", "episodes.parquet", "index.html"
COMPARISON_FILE = "comparison.html"
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
        videos: Number of failures of each policy, and of different episodes of each pair, to show on the page.
        tell: Progress callback of the videos.

    Raises:
        WorldError: The directory cannot be written.
    """
    evaluation = evaluation_of(campaign, store)
    _write(store.root / RESULTS_FILE, (evaluation.model_dump_json(indent=1) + "\n").encode())
    rows = [row for name in campaign.policies for row in store.results(name)]
    with replacing(store.root / TABLE_FILE) as part:
        pq.write_table(pa.Table.from_pylist([_flat(row) for row in rows]), part)
    results = {name: store.results(name) for name in campaign.policies}
    wanted = _failures(campaign, store, videos) | _different(evaluation.comparisons, results, store.root, videos)
    films = _filmed(wanted, campaign.specs, campaign.root, campaign.setup.renderer, tell)
    _write(store.root / PAGE_FILE, write_page(evaluation, films).encode())
    return evaluation


def publish_comparison(
    runs: Sequence[PolicyResults],
    variant: Variant,
    out: Path,
    dataset: Path | None,
    videos: int,
    tell: ProgressCallback,
) -> list[PairedComparison]:
    """Writes the page of comparisons of policies and returns the comparisons.

    Args:
        runs: Results of two or more policies.
        variant: Variant of the instruction.
        out: Folder of the page.
        dataset: Dataset with the scenes of the videos; `None` for a page without videos.
        videos: Number of videos of each pair of policies.
        tell: Progress callback of the videos.

    Raises:
        UsageError: No two policies have run a common episode.
        WorldError: The folder cannot be written, or the dataset has not the scenes.
    """
    results = {run.policy: run.results for run in runs}
    comparisons = require_common(compare_all([run.results for run in runs], variant), variant)
    films: dict[Names, list[EpisodeFilm]] = {}
    out.mkdir(parents=True, exist_ok=True)
    if dataset is not None:
        wanted = _different(comparisons, results, out, videos)
        films = _filmed(wanted, runs[0].specs, dataset, "auto", tell)
    _write(out / COMPARISON_FILE, write_comparison_page(comparisons, films).encode())
    return comparisons


def _failures(campaign: Campaign, store: Store, videos: int) -> dict[Names, list[_Film]]:
    """Returns the videos of failures of each policy."""
    chosen: dict[Names, list[_Film]] = {}
    for name in campaign.policies:
        rows = choose_failures([row for row in store.results(name) if row.variant is Variant.ORIGINAL], videos)
        chosen[(name,)] = [_Film((row,), store.folder(name) / VIDEOS) for row in rows]
    return chosen


def _different(
    comparisons: Sequence[PairedComparison], results: Mapping[str, Sequence[EpisodeResult]], root: Path, videos: int
) -> dict[Names, list[_Film]]:
    """Returns the videos of episodes in which one policy of a pair succeeded."""
    chosen: dict[Names, list[_Film]] = {}
    for comparison in comparisons:
        first, second = comparison.first, comparison.second
        pairs = pairs_of(results[first], results[second], comparison.variant)
        folder = pair_folder(root, first, second)
        chosen[first, second] = [_Film(pair, folder) for pair in choose_different(pairs, videos)]
    return chosen


def pair_folder(root: Path, first: str, second: str) -> Path:
    """Returns the folder of the videos of a pair of policies."""
    return root / "comparisons" / f"{folder_name(first)}+{folder_name(second)}"


class _Film(NamedTuple):
    """Video to draw."""

    rows: tuple[EpisodeResult, ...]
    """Results of one episode, of one policy or of two."""
    folder: Path

    @property
    def path(self) -> Path:
        return self.folder / f"{self.rows[0].spec_id}.mp4"


def _filmed(
    wanted: Mapping[Names, Sequence[_Film]],
    specs: SpecSet,
    root: Path,
    renderer: RendererKind,
    tell: ProgressCallback,
) -> dict[Names, list[EpisodeFilm]]:
    """Returns the videos; draws a video only if its file does not exist."""
    films = [film for films in wanted.values() for film in films]
    shas = {spec.scene: spec.scene_sha256 for spec in specs.specs}
    task, camera, places = specs.settings.task, specs.settings.camera, LoadedScenes(root)
    with ExitStack() as stack:
        stage: SimulationContext | None = None
        for number, film in enumerate(films, 1):
            poster = film.path.with_suffix(".jpg")
            if not (film.path.exists() and poster.exists()):
                stage = stage or stack.enter_context(SimulationContext(renderer))
                row = film.rows[0]
                scene = places.load(row.scene, shas[row.scene]).compiled
                if len(film.rows) == 1:
                    pictures = list(draw_frames(row, scene, task, stage.renderer, camera))
                else:
                    pictures = list(draw_pair((row, film.rows[1]), scene, task, stage.renderer, camera))
                film.folder.mkdir(parents=True, exist_ok=True)
                _write(poster, draw_poster(pictures[-1]))
                write_mp4(film.path, pictures, FILM_RATE, FILM_CRF)
            tell(number, len(films))
    return {
        names: [
            EpisodeFilm(film.rows, film.path.read_bytes(), film.path.with_suffix(".jpg").read_bytes()) for film in films
        ]
        for names, films in wanted.items()
    }


def evaluation_of(campaign: Campaign, store: Store) -> Evaluation:
    """Returns the tables of the finished episodes."""
    scores = []
    runs = []
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
        runs.append(results)
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
        comparisons=tuple(compare_all(runs)),
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
