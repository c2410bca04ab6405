"""Format `rlds`: a TFDS dataset of RLDS episodes, for OpenVLA, Octo and Open X-Embodiment, without TensorFlow.

Files, names and encodings are those that TFDS 4.9 writes and `tfds.builder_from_directory` reads.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypedDict

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray
from PIL import Image

from factory.dataset.episode import Episode
from factory.export.base import Exporter, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.lerobot.columns import frame_columns, kept_frames
from factory.export.options import RldsOptions, stride_of
from factory.export.origin import origin_of
from factory.export.rig.description import optical_poses
from factory.export.rig.reader import shown_pinhole
from factory.export.shards import ShardFacts, join_files, shards_of
from factory.export.source import instances_json, to_json
from factory.export.tfrecord import BytesFeature, encode_floats, encode_ints, encode_texts, write_example
from schemas.encoding.png import encode_png
from schemas.terms import Split

_BASE = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
"""Pose of base_link in itself."""


class RldsObservation(TypedDict):
    """Observation of a step."""

    image: NDArray[np.uint8]
    """(image_px, image_px, 3) sRGB."""
    depth: NDArray[np.float32]
    """(image_px, image_px, 1) depth along the optical axis, metres; 0 without a hit; nearest-neighbour resampling."""
    ids: NDArray[np.uint16]
    """(image_px, image_px, 1) instance ids; 0 is background; nearest-neighbour resampling."""
    state: NDArray[np.float32]
    """(5,) wheel odometry: x, y, yaw in the frame of the first pose (m, rad), v and w (m/s, rad/s)."""


class Step(TypedDict):
    """RLDS step."""

    observation: RldsObservation
    action: NDArray[np.float32]
    """(2,) mean command until the next step: v (m/s), w (rad/s)."""
    action_tokens: NDArray[np.int32]
    """(2,) tokens of the action on the 7 x 7 grid."""
    discount: float
    reward: float
    """1 at the last step, else 0; every archived episode is successful."""
    is_first: bool
    is_last: bool
    is_terminal: bool
    language_instruction: str
    camera_pose: NDArray[np.float32]
    """(7,) x, y, z, qw, qx, qy, qz of the optical frame (x right, y down, z forward) in the world, metres."""


def rlds_steps(episode: Episode, fps: int | None = None, image_px: int = 256) -> Iterator[Step]:
    """Yields the steps of an episode, with one frame in memory at a time.

    Args:
        episode: episode to convert.
        fps: steps per second, a divisor of the recorded rate; `None` for all frames.
        image_px: side of the images, pixels; 640 is the recorded size.

    Raises:
        UsageError: the rate does not divide the recorded rate.
        ArchiveCorrupt: the episode is damaged.
    """
    hz = episode.meta.job.task.control_hz
    stride = stride_of(fps, hz)
    kept = kept_frames(len(episode), stride)
    columns = frame_columns(episode.actions, episode.poses, hz, stride)
    tokens = columns.tokens.astype(np.int32)
    cameras = optical_poses(episode.poses[np.asarray(kept)], shown_pinhole(episode).mount).astype(np.float32)
    for number, t in enumerate(kept):
        is_last = number == len(kept) - 1
        yield {
            "observation": {
                "image": _resize(episode.rgb(t), image_px),
                "depth": _nearest(episode.depth(t), image_px)[:, :, None],
                "ids": _nearest(episode.ids(t), image_px)[:, :, None],
                "state": columns.state[number],
            },
            "action": columns.action[number],
            "action_tokens": tokens[number],
            "discount": 1.0,
            "reward": float(is_last),
            "is_first": number == 0,
            "is_last": is_last,
            "is_terminal": is_last,
            "language_instruction": episode.instruction,
            "camera_pose": cameras[number],
        }


def rlds_metadata(episode: Episode, image_px: int = 256) -> dict[str, Any]:
    """Returns the metadata of an episode; `instances` names the ids, as JSON.

    Args:
        episode: episode to describe.
        image_px: side of the images, pixels, to which `camera_matrix` (3, 3) refers; the centre of the first pixel is
            (0, 0). `camera_in_base` is the pose of the optical frame in base_link: x, y, z, qw, qx, qy, qz.
    """
    row, camera = episode.summary, shown_pinhole(episode)
    (fx, fy), (cx, cy), scale = camera.focal_px, camera.centre_px, image_px / camera.width
    matrix = ((fx * scale, 0.0, cx * scale - 0.5), (0.0, fy * scale, cy * scale - 0.5), (0.0, 0.0, 1.0))
    return {
        "episode_id": row.episode_id,
        "split": str(row.split),
        "scene": row.scene,
        "target_category": row.target_category,
        "target_id": row.target_id,
        "target_instance_id": episode.meta.target_instance_id,
        "target_centroid_m": list(episode.meta.target_centroid_m),
        "instances": instances_json(episode.instances),
        "template_id": row.template_id,
        "states_digest": episode.states_digest,
        "origin": origin_of(episode).to_json(),
        "camera_matrix": [list(row) for row in matrix],
        "camera_in_base": optical_poses(_BASE, camera.mount)[0].tolist(),
    }


def _resize(rgb: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
    if rgb.shape[0] == side:
        return rgb
    return np.asarray(Image.fromarray(rgb).resize((side, side), Image.Resampling.BOX))


def _nearest(image: NDArray[Any], side: int) -> NDArray[Any]:
    chosen = ((np.arange(side) + 0.5) * image.shape[0] / side).astype(int)
    return np.asarray(image[chosen[:, None], chosen[None, :]])


DATASET_NAME = "minivla_nav"
VERSION = "1.3.0"
"""Version of the features; TFDS's rules: a new minor version when features are added."""
RELEASE_NOTES = {
    "1.0.0": "Initial release.",
    "1.1.0": "The metadata has `origin`.",
    "1.2.0": "Steps have `camera_pose`, the metadata `camera_matrix` and `camera_in_base`.",
    "1.3.0": "Steps have `ids`, the metadata `instances`, `target_instance_id` and `target_centroid_m`.",
}
FOLDER = f"{DATASET_NAME}/{VERSION}"
"""Folder of the dataset in the export, for `tfds.builder_from_directory`."""
_LOADER_SPLITS = {str(Split.TRAIN_ID): "train", str(Split.VAL_ID): "val"}
_RECORD_FILE = "episode.tfrecord"
_DEPTH_LEVEL = 3
"""Level of isal's deflate, the same as for the gzipped depth of webdataset."""
_STEPS, _METADATA = "steps", "episode_metadata"
_CLASSES = {
    "FeaturesDict": "features_dict.FeaturesDict",
    "Dataset": "dataset_feature.Dataset",
    "Image": "image_feature.Image",
    "Tensor": "tensor_feature.Tensor",
    "Scalar": "scalar.Scalar",
    "Text": "text_feature.Text",
}
_DESCRIPTION = "Language-conditioned robot navigation in simulated rooms, made with minivla-factory."
_CARD = """
The folder `{folder}` is a TFDS dataset of RLDS episodes. Open it with `tfds.builder_from_directory("{folder}")`, or
with `tfds.load("{name}", data_dir=...)` and the path of this folder; splits: {splits}.

| feature | content |
|---|---|
{features}
Steps have {hz} frames per second. `depth` is 0 where nothing was hit; `ids` are 0 in the background, and `instances` of
the metadata names them as JSON. The reward is 1 at the last step: every archived episode is a success.

OpenVLA and Octo: the dataset is `{name}`, and their `data_dir` is this folder. They read the splits `train` and `val`
(`--loader-splits`); the transforms and entries to register are in `docs/formats/rlds` of minivla-factory.
"""


class Feature(NamedTuple):
    """Feature of a TFDS dataset."""

    kind: Literal["Image", "Tensor", "Scalar", "Text"]
    dtype: str = ""
    shape: tuple[int, ...] = ()
    doc: str = ""
    zlib: bool = False
    """Whether a tensor is stored compressed."""

    @property
    def is_long(self) -> bool:
        """Whether the values are stored as bytes that are too large to be collected in memory."""
        return self.zlib or self.kind == "Image"

    def to_json(self) -> dict[str, Any]:
        """Returns the feature as an entry of `features.json`."""
        shape = {"dimensions": [str(size) for size in self.shape]} if self.shape else {}
        values: dict[str, Any] = {"pythonClassName": _class_name(self.kind)}
        if self.kind == "Text":
            values["text"] = {}
        elif self.kind == "Image":
            values["image"] = {"shape": shape, "dtype": self.dtype, "encodingFormat": "png"}
        else:
            values["tensor"] = {"shape": shape, "dtype": self.dtype, "encoding": "zlib" if self.zlib else "none"}
        return values | ({"description": self.doc} if self.doc else {})

    def encode_one(self, value: NDArray[Any]) -> bytes:
        """Returns a long value as TFDS stores it."""
        if self.kind == "Image":
            return encode_png(value[:, :, 0] if value.shape[2] == 1 else value)
        return bytes(isal_zlib.compress(np.ascontiguousarray(value).tobytes(), _DEPTH_LEVEL))

    def encode_all(self, values: Sequence[Any]) -> bytes:
        """Returns the values of all steps as a feature of an example; values must not be long."""
        if self.kind == "Text":
            return encode_texts(values)
        return (encode_floats if self.dtype.startswith("float") else encode_ints)(np.asarray(values, self.dtype))


def step_features(side: int) -> dict[str, Feature]:
    """Returns the features of a step with images of `side` pixels; `/` separates the names of nested features."""
    return {
        "observation/image": Feature("Image", "uint8", (side, side, 3), "sRGB"),
        "observation/depth": Feature("Tensor", "float32", (side, side, 1), "m along the optical axis", zlib=True),
        "observation/ids": Feature("Image", "uint16", (side, side, 1), "instance ids"),
        "observation/state": Feature("Tensor", "float32", (5,), "x, y, yaw since frame 0; v, w"),
        "action": Feature("Tensor", "float32", (2,), "v in m/s, w in rad/s; mean until the next step"),
        "action_tokens": Feature("Tensor", "int32", (2,), "0..6 on the 7 x 7 grid"),
        "discount": Feature("Scalar", "float32"),
        "reward": Feature("Scalar", "float32"),
        "is_first": Feature("Scalar", "bool"),
        "is_last": Feature("Scalar", "bool"),
        "is_terminal": Feature("Scalar", "bool"),
        "language_instruction": Feature("Text"),
        "camera_pose": Feature("Tensor", "float32", (7,), "x, y, z, qw, qx, qy, qz in the world"),
    }


def metadata_features() -> dict[str, Feature]:
    """Returns the features of the metadata of an episode."""
    names = ("episode_id", "split", "scene", "target_category", "target_id", "template_id", "states_digest", "origin")
    return {
        **dict.fromkeys(names, Feature("Text")),
        "instances": Feature("Text", doc="JSON: names of the ids"),
        "target_instance_id": Feature("Scalar", "int32", doc="id of the target in the ids"),
        "target_centroid_m": Feature("Tensor", "float32", (3,), "in the world"),
        "camera_matrix": Feature("Tensor", "float32", (3, 3), "of the exported images"),
        "camera_in_base": Feature("Tensor", "float32", (7,), "x, y, z, qw, qx, qy, qz"),
    }


class RldsExporter(Exporter[RldsOptions, ShardFacts]):
    """Exporter of format `rlds`. A piece is a TFRecord file with one example; pieces form a shard."""

    name = "rlds"
    about = "TFDS dataset of RLDS episodes, for OpenVLA and Octo; lossless images of 256 px"
    requires = ("google_crc32c",)
    assembles = True
    options = RldsOptions
    facts = ShardFacts

    def write_episode(self, episode: Episode, options: RldsOptions, folder: Path) -> ShardFacts:
        """Writes the example of the episode; images are collected in files."""
        features = step_features(options.image_px)
        columns: dict[str, list[Any]] = {name: [] for name, feature in features.items() if not feature.is_long}
        with ExitStack() as stack:
            long = {
                name: stack.enter_context(BytesFeature(folder / f"{name.rpartition('/')[2]}.part"))
                for name, feature in features.items()
                if feature.is_long
            }
            frames = 0
            for step in rlds_steps(episode, options.fps, options.image_px):
                frames += 1
                for name, value in _flat(step).items():
                    if name in long:
                        long[name].add(features[name].encode_one(value))
                    else:
                        columns[name].append(value)
        about = metadata_features()
        short = {f"{_STEPS}/{name}": features[name].encode_all(values) for name, values in columns.items()}
        for name, value in rlds_metadata(episode, options.image_px).items():
            short[f"{_METADATA}/{name}"] = about[name].encode_all([value])
        paths = {f"{_STEPS}/{name}": values.path for name, values in long.items()}
        return ShardFacts(frames=frames, member_bytes=write_example(folder / _RECORD_FILE, short, paths))

    def finish(self, export: Finish[RldsOptions, ShardFacts]) -> None:
        """Joins the pieces of each split into shards; writes the description of the dataset and the card."""
        options, splits = export.options, []
        for split in dict.fromkeys(piece.split for piece in export.pieces):
            name = _LOADER_SPLITS.get(split, split) if options.loader_splits else split
            pieces = [piece for piece in export.pieces if piece.split == split]
            shards = list(shards_of(pieces, options.shard_mb * 1_000_000))
            for number, shard in enumerate(shards):
                file = f"{FOLDER}/{DATASET_NAME}-{name}.tfrecord-{number:05d}-of-{len(shards):05d}"
                if not export.out.has(file):
                    with export.out.replacing(file) as part:
                        join_files((piece.folder / _RECORD_FILE for piece in shard.pieces), part)
            splits.append(
                {
                    "filepathTemplate": "{DATASET}-{SPLIT}.{FILEFORMAT}-{SHARD_X_OF_Y}",
                    "name": name,
                    "numBytes": str(sum(shard.size for shard in shards)),
                    "shardLengths": [str(len(shard.pieces)) for shard in shards],
                }
            )
        export.out.write_text(f"{FOLDER}/features.json", to_json(features_json(options.image_px)))
        export.out.write_text(f"{FOLDER}/dataset_info.json", to_json(_info(splits)))
        text = _CARD.format(
            folder=FOLDER,
            name=DATASET_NAME,
            splits=", ".join(f"`{split['name']}`" for split in splits),
            features=_rows(options.image_px),
            hz=options.fps or export.dataset.meta.plan.task.control_hz,
        )
        card = export_card(export.dataset.meta, None, len(export.pieces), text, tags=("rlds", "tfds"))
        export.out.write_text(CARD_FILE, card)


def features_json(side: int) -> dict[str, Any]:
    """Returns the content of `features.json` of a dataset with images of `side` pixels."""
    steps = {"sequence": {"feature": _nested(step_features(side)), "length": "-1"}}
    parts = {_METADATA: _nested(metadata_features()), _STEPS: {"pythonClassName": _class_name("Dataset"), **steps}}
    return {"pythonClassName": _class_name("FeaturesDict"), "featuresDict": {"features": parts}}


def _nested(features: Mapping[str, Feature]) -> dict[str, Any]:
    """Returns features as an entry of `features.json`, with inner dictionaries where names have a `/`."""
    inner: dict[str, dict[str, Feature]] = {}
    entries = {}
    for name, feature in features.items():
        group, _, rest = name.partition("/")
        if rest:
            inner.setdefault(group, {})[rest] = feature
        else:
            entries[name] = feature.to_json()
    entries |= {group: _nested(members) for group, members in inner.items()}
    named = {name: entries[name] for name in sorted(entries)}
    return {"pythonClassName": _class_name("FeaturesDict"), "featuresDict": {"features": named}}


def _class_name(kind: str) -> str:
    return f"tensorflow_datasets.core.features.{_CLASSES[kind]}"


def _info(splits: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the content of `dataset_info.json`."""
    return {
        "description": _DESCRIPTION,
        "fileFormat": "tfrecord",
        "moduleName": f"{DATASET_NAME}.{DATASET_NAME}_dataset_builder",
        "name": DATASET_NAME,
        "releaseNotes": RELEASE_NOTES,
        "splits": splits,
        "version": VERSION,
    }


def _rows(side: int) -> str:
    """Returns the rows of the card's table of features."""
    named = {f"{_STEPS}/{name}": feature for name, feature in step_features(side).items()}
    named |= {f"{_METADATA}/{name}": feature for name, feature in metadata_features().items()}
    lines = []
    for name, feature in named.items():
        kind = "text" if feature.kind == "Text" else " ".join((feature.dtype, *map(str, [feature.shape or ""]))).strip()
        lines.append(f"| `{name}` | {kind}{f': {feature.doc}' if feature.doc else ''} |\n")
    return "".join(lines)


def _flat(step: Step) -> dict[str, Any]:
    observation = {f"observation/{name}": value for name, value in step["observation"].items()}
    return observation | {name: value for name, value in step.items() if name != "observation"}
