"""Format `gnm`: training data for GNM, ViNT and NoMaD, as numbered JPEGs, positions and headings, and lists of names.

Layout and keys are those of robodhruv/visualnav-transformer. Does not contain instructions, depth or ids.
"""

from __future__ import annotations

import io
import math
import pickle
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from factory.dataset.episode import Episode
from factory.export.base import EpisodeFacts, Exporter, ExportPiece, Finish
from factory.export.card import CARD_FILE, export_card
from factory.export.options import GnmOptions, stride_of
from factory.export.origin import write_origin
from factory.export.questions import ask_questions, questions_text
from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.support.geometry import yaw_of
from schemas.terms import Split

DATASET_NAME = "minivla_nav"
"""Name of the dataset in `data_config.yaml` and `data_splits`."""
_PICKLE_PROTOCOL = 2
_LOADER_SPLITS = ("train", "test")
_TEST_SPLITS = frozenset(split for split in Split if split not in (Split.TRAIN_ID, Split.VAL_ID))
_CARD = """
- `{name}/ep_000001/0.jpg, 1.jpg, ...` and `traj_data.pkl`: `position` (T, 2) metres and `yaw` (T,) radians of base_link
  in the world frame, float64. Row i is where frame i was taken.
- `data_splits/{name}/train/traj_names.txt`: the episodes of `train_id`; `test/`: those of `val_id`, or those of
  the test splits if the dataset has no `val_id` episodes. The loaders read only these two lists. Every split has a
  folder.
- `data_config.yaml`: the entry to paste into `vint_train/data/data_config.yaml`.

In the training configuration:

```yaml
datasets:
  {name}:
    data_folder: <here>/{name}
    train: <here>/data_splits/{name}/train/
    test: <here>/data_splits/{name}/test/
    end_slack: 0
    goals_per_obs: 1
    negative_mining: True
```

The loaders skip trajectories of no more than context_size + len_traj_pred frames (5 + 5 in ViNT). This dataset
has {fps} frames per second; the median episode has {median} frames.
"""


class GnmFacts(EpisodeFacts):
    """Facts of a piece that are needed to compute the mean distance between waypoints."""

    length_m: float
    """Sum of the distances between consecutive exported frames, metres."""


class GnmExporter(Exporter[GnmOptions, GnmFacts]):
    """Exporter of format `gnm`: one folder per episode; frames are numbered from 0 without gaps at every rate."""

    name = "gnm"
    about = "JPEG folders with positions and headings, for GNM, ViNT and NoMaD"
    version = 5
    asks = True
    options = GnmOptions
    facts = GnmFacts

    def write_episode(self, episode: Episode, options: GnmOptions, folder: Path) -> GnmFacts:
        """Writes `minivla_nav/<id>/`."""
        steps = range(0, len(episode), stride_of(options.fps, episode.meta.job.task.control_hz))
        place = folder / DATASET_NAME / episode.episode_id
        place.mkdir(parents=True)
        for number, t in enumerate(steps):
            (place / f"{number}.jpg").write_bytes(encode_jpeg(episode.rgb(t), options.jpeg_quality))
        poses = episode.poses[:: steps.step]
        position = poses[:, :2]
        yaw = yaw_of(poses)
        (place / "traj_data.pkl").write_bytes(pickle_arrays({"position": position, "yaw": yaw}))
        write_origin(episode, place)
        questions = ask_questions(episode, steps, lambda n, _: f"{DATASET_NAME}/{episode.episode_id}/{n}.jpg")
        return GnmFacts(frames=len(steps), length_m=_length(position), questions=questions)

    def finish(self, export: Finish[GnmOptions, GnmFacts]) -> None:
        """Writes the lists of names, the configuration entry and the card."""
        by_split: dict[str, list[str]] = {}
        for piece in export.pieces:
            by_split.setdefault(piece.split, []).append(piece.episode_id)
        for name, episodes in {**by_split, **_loader_lists(by_split)}.items():
            lines = "".join(f"{episode}\n" for episode in episodes)
            export.out.write_text(f"data_splits/{DATASET_NAME}/{name}/traj_names.txt", lines)
        job = export.dataset.meta.plan
        export.out.write_text("data_config.yaml", _config(job.camera, _spacing(export.pieces)))
        fps = export.options.fps or job.task.control_hz
        frames = sorted(piece.facts.frames for piece in export.pieces)
        text = _CARD.format(name=DATASET_NAME, fps=fps, median=frames[len(frames) // 2])
        asked = questions_text(export.questions, self.asks)
        card = export_card(export.dataset.meta, None, len(export.pieces), text, tags=("gnm",), questions=asked)
        export.out.write_text(CARD_FILE, card)


def encode_jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    """Returns a JPEG, encoded in memory: Pillow would not detect a partial write to a full disk."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=quality)
    return buffer.getvalue()


def _length(position: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())


def _loader_lists(by_split: dict[str, list[str]]) -> dict[str, list[str]]:
    """Returns the episodes of the lists `train` and `test`, which the loaders read.

    `test` has the episodes of `val_id` or, if there are none, those of the test splits.
    """
    held_out = by_split.get(Split.VAL_ID) or [
        episode for split, episodes in by_split.items() if split in _TEST_SPLITS for episode in episodes
    ]
    return dict(zip(_LOADER_SPLITS, (by_split.get(Split.TRAIN_ID, []), sorted(held_out)), strict=True))


def _spacing(pieces: Sequence[ExportPiece[GnmFacts]]) -> float:
    """Returns the mean distance between consecutive frames, metres; the loaders divide waypoints by it."""
    length, steps = 0.0, 0
    for piece in pieces:
        facts = piece.facts
        length, steps = length + facts.length_m, steps + facts.frames - 1
    return length / steps if steps else 0.0


def _config(camera: CameraConfig, spacing_m: float) -> str:
    focal = FRAME_SIZE_PX / 2 / math.tan(math.radians(camera.fov_deg) / 2)
    centre = FRAME_SIZE_PX / 2 - 0.5
    entry = {
        "metric_waypoint_spacing": round(spacing_m, 6),  # mean distance between waypoints, metres
        "camera_metrics": {
            "camera_height": camera.z_m,
            "camera_x_offset": camera.x_m,
            "camera_matrix": {"fx": round(focal, 6), "fy": round(focal, 6), "cx": centre, "cy": centre},
            "dist_coeffs": dict.fromkeys(("k1", "k2", "p1", "p2", "k3"), 0.0),
        },
    }
    return yaml.safe_dump({DATASET_NAME: entry}, sort_keys=False)


def pickle_arrays(arrays: Mapping[str, NDArray[np.float64]]) -> bytes:
    """Returns the pickle of a dictionary of float64 arrays; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    _PortablePickler(buffer, _PICKLE_PROTOCOL).dump(dict(arrays))
    return buffer.getvalue()


class _PortablePickler(pickle.Pickler):
    """Pickles an array as a call of `numpy.array` on a list of floats.

    numpy's own pickles refer to `numpy._core`, which numpy 1.x does not have. GNM, ViNT and NoMaD pin numpy 1.x
    (Python 3.8).
    """

    def reducer_override(self, item: Any) -> Any:
        if isinstance(item, np.ndarray):
            return np.array, (item.tolist(), "float64")
        return NotImplemented
