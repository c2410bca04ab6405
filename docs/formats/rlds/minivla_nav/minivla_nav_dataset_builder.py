"""TFDS builder: a dataset of minivla-factory as RLDS episodes.

Run by `build.py` beside this folder, or by `tfds build`, which needs apache-beam as well:

    MINIVLA_DATASET=/data/office MINIVLA_FPS=10 python build.py /data/rlds

`MINIVLA_FPS` (default: the dataset's rate) must divide the dataset's rate; `MINIVLA_IMAGE_PX` (default 256) is the side
of the images. `MINIVLA_SPLITS=loaders` names the splits `train_id` and `val_id` as OpenVLA and Octo do: `train`, `val`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import tensorflow_datasets as tfds

from factory.export.rlds import rlds_metadata, rlds_steps
from minivla import Dataset

_IMAGE_PX = int(os.environ.get("MINIVLA_IMAGE_PX", "256"))
_SPLITS = {"train_id": "train", "val_id": "val"} if os.environ.get("MINIVLA_SPLITS") == "loaders" else {}
_FPS = int(os.environ["MINIVLA_FPS"]) if "MINIVLA_FPS" in os.environ else None


class MinivlaNav(tfds.core.GeneratorBasedBuilder):
    """One RLDS episode for each archived episode, in the splits of the dataset."""

    VERSION = tfds.core.Version("1.2.0")
    RELEASE_NOTES = {  # noqa: RUF012 - required by tfds
        "1.0.0": "Initial release.",
        "1.1.0": "The metadata has `origin`.",
        "1.2.0": "Steps have `camera_pose`, the metadata `camera_matrix` and `camera_in_base`.",
    }

    def _info(self) -> tfds.core.DatasetInfo:
        side = _IMAGE_PX
        observation = {
            "image": tfds.features.Image(shape=(side, side, 3), dtype=np.uint8, encoding_format="png"),
            "depth": tfds.features.Tensor(shape=(side, side, 1), dtype=np.float32, encoding="zlib"),
            "state": tfds.features.Tensor(shape=(5,), dtype=np.float32, doc="x, y, yaw since frame 0; v, w"),
        }
        steps = {
            "observation": tfds.features.FeaturesDict(observation),
            "action": tfds.features.Tensor(shape=(2,), dtype=np.float32, doc="v in m/s, w in rad/s"),
            "action_tokens": tfds.features.Tensor(shape=(2,), dtype=np.int32, doc="0..6 on the 7 x 7 grid"),
            "discount": tfds.features.Scalar(dtype=np.float32),
            "reward": tfds.features.Scalar(dtype=np.float32),
            "is_first": tfds.features.Scalar(dtype=np.bool_),
            "is_last": tfds.features.Scalar(dtype=np.bool_),
            "is_terminal": tfds.features.Scalar(dtype=np.bool_),
            "language_instruction": tfds.features.Text(),
            "camera_pose": tfds.features.Tensor(
                shape=(7,), dtype=np.float32, doc="x, y, z, qw, qx, qy, qz in the world"
            ),
        }
        names = ("episode_id", "split", "scene", "target_category", "target_id", "template_id")
        names += ("states_digest", "origin")
        metadata = {name: tfds.features.Text() for name in names}
        metadata["camera_matrix"] = tfds.features.Tensor(shape=(3, 3), dtype=np.float32, doc="of the exported images")
        metadata["camera_in_base"] = tfds.features.Tensor(shape=(7,), dtype=np.float32, doc="x, y, z, qw, qx, qy, qz")
        features = {"steps": tfds.features.Dataset(steps), "episode_metadata": metadata}
        return self.dataset_info_from_configs(features=tfds.features.FeaturesDict(features))

    def _split_generators(self, dl_manager: Any) -> dict[str, Iterator[tuple[str, dict[str, Any]]]]:
        del dl_manager  # nothing is downloaded
        dataset = Dataset(os.environ["MINIVLA_DATASET"])
        splits = dict.fromkeys(dataset.metadata["split"].to_pylist())
        return {_SPLITS.get(split, split): self._generate_examples(dataset.filter(split=split)) for split in splits}

    def _generate_examples(self, dataset: Dataset) -> Iterator[tuple[str, dict[str, Any]]]:
        for episode in dataset:
            with episode:
                steps = list(rlds_steps(episode, _FPS, _IMAGE_PX))
                yield episode.episode_id, {"steps": steps, "episode_metadata": rlds_metadata(episode, _IMAGE_PX)}
