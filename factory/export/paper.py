"""Format `paper`: the directory tree in the paper's table of episode files, one file per frame and sensor; lossless.

A states dataset gives the same tree as a frames dataset: the frames are rendered, and their digests are computed. A rig
has one folder per sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts, Exporter, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.options import PaperOptions
from factory.export.origin import write_origin
from factory.export.questions import ask_questions, questions_text
from factory.export.rig.description import rig_table
from factory.export.rig.reader import SensorReader, arrays_of
from factory.export.source import TIMES_AND_WORKERS, as_frames, plain_dataset_meta, plain_meta, to_json
from schemas.bundle import EpisodeArrays, seal
from schemas.dataset.meta import DatasetMeta
from schemas.dataset.rows import PUBLISHED_COLUMNS
from schemas.encoding.arrays import EPISODE_ARRAYS
from schemas.encoding.digest import dataset_digest, frame_digest
from schemas.encoding.ndarray import encode_npy
from schemas.encoding.png import encode_png
from schemas.episode import EpisodeMeta
from schemas.rig import CameraOutput, Imu, WheelOdometry
from schemas.storage.dataset_files import META_FILE, METADATA_FILE, SPLITS_FOLDER
from schemas.terms import Recording, Split

FOLDERS_TEXT = """\
- `episodes/ep_000001/sensors/<sensor>/`: the sensors of the rig; the number of a file is the control step of the
  measurement. Cameras: `rgb/000000.png`, `depth/000000.npy` (float32 metres, axial or radial as `rig.json` has it),
  `ids/000000.png`, `normals/000000.npy`, `flow/000000.npy`. Lidars: `ranges/000000.npy` (lines, samples) float32
  metres, 0 without a return, and `ids/000000.png`. IMU: `angular_velocity.npy` (N, 3) rad/s, `specific_force.npy`
  (N, 3) m/s2. Odometry: `ticks.npy` (N, 2), `poses.npy` (N, 3) x, y, heading, `twists.npy` (N, 2). Row i of N was
  measured at step i times `every_steps` of `rig.json`.
"""
"""Text of the card."""


def write_sensors(reader: SensorReader, steps: int, folder: Path) -> None:
    """Writes `<folder>/<sensor>/` for each sensor of the rig, for an episode of `steps` steps."""
    for name, motion in reader.motion.items():
        for array, values in arrays_of(motion).items():
            _write(folder / name / f"{array}.npy", encode_npy(values))
    for sensor in reader.rig.sensors:
        if isinstance(sensor, Imu | WheelOdometry):
            continue
        for t in range(0, steps, reader.strides[sensor.name]):
            for name, image in reader.arrays(sensor, t).items():
                is_png = name in (CameraOutput.RGB, CameraOutput.IDS)
                file = folder / sensor.name / name / f"{t:06d}.{'png' if is_png else 'npy'}"
                _write(file, encode_png(image) if is_png else encode_npy(image))


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


PUBLISHED_SPLITS = {str(Split.TEST_PARAPHRASE_OOD): "test_ood_lang"}
"""The paper's name of a split -> the name in the published repository, where they differ
(docs/design/task.md#splits-and-instructions)."""
_OF_THE_BUNDLE = frozenset({"file_sha256", "file_bytes", "file_name", *TIMES_AND_WORKERS})
_CARD = """
- `episodes/ep_000001/rgb_front/000000.png`: 640 x 640, 8 bit; `depth_front/000000.npy`: float32 metres along the
  optical axis, 0 where nothing was hit; `seg_front/000000.png`: 16-bit instance ids, named in `meta.json`.
- `actions_continuous.npy` (T, 2): v in m/s, w in rad/s; `actions_tokens.npy` (T, 2): 0..6; `poses.npy` (T, 7): x, y, z,
  qw, qx, qy, qz of base_link in the world frame. Frame t is what the robot saw before action t.
- `metadata.parquet`: one row an episode; `data/<split>.parquet`: the same rows by split;
  `dataset_meta.json`: plan, seed, versions. `rig.json`: intrinsics and mounting pose of the camera.
"""


class PaperFacts(EpisodeFacts):
    """Values of the metadata rows that a states dataset does not store."""

    content_digest: str
    """Content digest that a frames recording of the episode has."""
    steps_visible: int | None
    """Number of frames in which the target is visible."""


class PaperExporter(Exporter[PaperOptions, PaperFacts]):
    """Exporter of format `paper`: one folder per episode. Copies the bytes of the bundle; depth is decompressed."""

    name = "paper"
    about = "the paper's tree: PNG, NPY and PNG for each frame; lossless and large"
    version = 5
    asks = True
    takes_rig = True
    options = PaperOptions
    facts = PaperFacts

    def write_episode(self, episode: Episode, options: PaperOptions, folder: Path) -> PaperFacts:
        """Writes `episodes/<id>/`, with the sensors of a rig below `sensors/`."""
        root = folder / "episodes" / episode.episode_id
        for name in ("rgb_front", "depth_front", "seg_front"):
            (root / name).mkdir(parents=True)
        digests, visible = [], 0
        is_stored = episode.meta.job.record is Recording.FRAMES
        for t in range(len(episode)):
            for name in (f"rgb_front/{t:06d}.png", f"seg_front/{t:06d}.png"):
                (root / name).write_bytes(episode.stored(name))
            (root / f"depth_front/{t:06d}.npy").write_bytes(encode_npy(episode.depth(t)))
            if not is_stored:
                digests.append(frame_digest(episode.rgb(t), episode.depth(t), episode.ids(t)))
                visible += _shows_target(episode, t)
        for spec in EPISODE_ARRAYS:
            (root / f"{spec.name}.npy").write_bytes(episode.stored(f"{spec.name}.npy"))
        meta = episode.meta if is_stored else _sealed(episode, digests, visible)
        (root / "meta.json").write_text(_to_text(meta, options), encoding="utf-8")
        write_origin(episode, root)
        if episode.rig is not None:
            write_sensors(SensorReader(episode), len(episode), root / "sensors")
        pictures = f"episodes/{episode.episode_id}/rgb_front"
        return PaperFacts(
            frames=len(episode),
            content_digest=meta.content_digest,
            steps_visible=meta.rollout.steps_visible,
            questions=ask_questions(episode, range(len(episode)), lambda _, t: f"{pictures}/{t:06d}.png"),
        )

    def finish(self, export: Finish[PaperOptions, PaperFacts]) -> None:
        """Writes `metadata.parquet`, its rows by split, `dataset_meta.json` and the card."""
        table = _metadata(export)
        with export.out.replacing(METADATA_FILE) as part:
            pq.write_table(table, part, compression="zstd")
        splits = list(dict.fromkeys(table["split"].to_pylist()))
        for split in splits:
            with export.out.replacing(f"{SPLITS_FOLDER}/{split}.parquet") as part:
                pq.write_table(table.filter(pc.equal(table["split"], split)), part, compression="zstd")
        meta = _part_of(export.dataset.meta, table)
        configs = {
            "default": {split: f"{SPLITS_FOLDER}/{split}.parquet" for split in splits},
            "metadata": {"train": METADATA_FILE},
        }
        text, hz, rig = _CARD, meta.plan.task.control_hz, export.dataset.rig
        if rig is not None:
            text += FOLDERS_TEXT + rig_table(rig, hz)
        asked = questions_text(export.questions, self.asks)
        card = export_card(meta, rig, len(export.pieces), text, configs, questions=asked)
        export.out.write_text(CARD_FILE, card)
        export.out.write_text(META_FILE, to_json(plain_dataset_meta(meta)))


def published_split(name: str, options: PaperOptions) -> str:
    """Returns the name of a split in the export."""
    return PUBLISHED_SPLITS.get(name, name) if options.split_names == "published" else name


def _shows_target(episode: Episode, t: int) -> bool:
    meta = episode.meta
    return int(np.count_nonzero(episode.ids(t) == meta.target_instance_id)) >= meta.job.gains.min_mask_px


def _sealed(episode: Episode, frame_digests: Sequence[str], steps_visible: int) -> EpisodeMeta:
    """Returns the metadata that a frames recording of the same episode has."""
    arrays = EpisodeArrays(episode.actions, episode.tokens, episode.poses)
    return seal(as_frames(episode, steps_visible), frame_digests, arrays)


def _to_text(meta: EpisodeMeta, options: PaperOptions) -> str:
    """Returns `meta.json`, with the name of the split in the export."""
    values = plain_meta(meta)
    values["job"]["split"] = published_split(values["job"]["split"], options)
    return to_json(values)


def _metadata(export: Finish[PaperOptions, PaperFacts]) -> pa.Table:
    """Returns the rows of the episodes: the published columns, then all others except those about the bundle file."""
    table, facts = export.dataset.metadata, [piece.facts for piece in export.pieces]
    ours = [name for name in table.column_names if name not in {*PUBLISHED_COLUMNS, *_OF_THE_BUNDLE}]
    rows = _decoded(table.take([piece.position for piece in export.pieces]).select([*PUBLISHED_COLUMNS, *ours]))
    meta = export.dataset.meta
    sources = [meta.source_of(index) for index in rows["index"].to_pylist()]
    framed = {each.first: each.plan.model_copy(update={"record": Recording.FRAMES}) for each in meta.sources}
    plans = [meta.plan if source is None else framed[source.first] for source in sources]
    values = {
        "split": [published_split(name, export.options) for name in rows["split"].to_pylist()],
        "content_digest": [one.content_digest for one in facts],
        "steps_visible": [one.steps_visible for one in facts],
        "plan_digest": [plan.digest for plan in plans],
        "run": [plan.run for plan in plans],
    }
    for name, column in values.items():
        place = rows.column_names.index(name)
        rows = rows.set_column(place, name, pa.array(column, rows.schema.field(place).type))
    return rows


def _decoded(table: pa.Table) -> pa.Table:
    """Returns a table with dictionary-encoded columns converted to plain text."""
    plain = [pa.field(x.name, x.type.value_type if pa.types.is_dictionary(x.type) else x.type) for x in table.schema]
    return table.cast(pa.schema(plain))


def _part_of(meta: DatasetMeta, rows: pa.Table) -> DatasetMeta:
    """Returns the metadata of the dataset, restricted to the exported episodes."""
    complete = rows.num_rows == meta.planned
    digests = zip(rows["episode_id"].to_pylist(), rows["content_digest"].to_pylist(), strict=True)
    digest = dataset_digest(digests) if complete else None
    return meta.model_copy(update={"episodes": rows.num_rows, "complete": complete, "dataset_digest": digest})
