"""Describes the features of a LeRobot dataset for `info.json` and the parquet schemas. Pure. Computes no values."""

from __future__ import annotations

import json
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field

from factory.export.base import Decimated
from factory.export.lerobot.columns import ACTION_NAMES, POSE_NAMES, STATE_NAMES, TOKEN_NAMES
from factory.export.video import DEPTH_CODEC, RGB_CODEC, Codec
from schemas.encoding.arrays import FRAME_SIZE_PX

LARGEST_CODE = 4095
"""Largest 12-bit depth code."""
SHIFT_M = 3.5
"""Offset of the logarithm, metres. Code 0 is 0 m, which means no hit."""
RGB, DEPTH, IDS = "observation.images.front", "observation.images.front_depth", "observation.images.front_ids"
FILES = {RGB: "front.mp4", DEPTH: "depth.mp4"}
"""Video feature -> file name in a piece."""
_IMAGE_NAMES = ["height", "width", "channels"]
VECTORS: dict[str, tuple[str, tuple[str, ...] | None]] = {
    "observation.state": ("float32", STATE_NAMES),
    "action": ("float32", ACTION_NAMES),
    "tokens": ("int64", TOKEN_NAMES),
    "pose": ("float32", POSE_NAMES),
    "timestamp": ("float32", None),
    "frame_index": ("int64", None),
    "episode_index": ("int64", None),
    "index": ("int64", None),
    "task_index": ("int64", None),
}
"""Numeric column -> dtype and names; columns without names are scalars. LeRobot policies use every column whose name
begins with `observation` or `action`; therefore tokens and the world pose have other names."""
_TYPES = {"float32": pa.float32(), "int64": pa.int64()}
_IMAGE_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])


class DepthCode:
    """Depth code for 0 to `far_m` metres. For a range of 30 m, the step is 2 mm at 0 m and 7 mm at 10 m."""

    def __init__(self, far_m: float) -> None:
        self.far_m = far_m
        self._low, self._span = np.log(SHIFT_M), np.log(far_m + SHIFT_M) - np.log(SHIFT_M)

    def encode(self, depth: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Converts metres to codes of the same shape."""
        scaled = (np.log(depth + np.float32(SHIFT_M)) - np.float32(self._low)) * np.float32(LARGEST_CODE / self._span)
        codes: NDArray[np.uint16] = np.rint(scaled, out=scaled).clip(0, LARGEST_CODE).astype(np.uint16)
        return codes

    def decode(self, codes: NDArray[np.generic]) -> NDArray[np.float64]:
        """Converts codes to metres."""
        metres: NDArray[np.float64] = np.exp(codes.astype(np.float64) * (self._span / LARGEST_CODE) + self._low)
        return np.clip(metres - SHIFT_M, 0.0, self.far_m)


class LeRobotOptions(Decimated):
    """Options of both LeRobot versions."""

    depth: bool = Field(default=False, description="Also write metric depth, as lossless 12-bit video. Default: no.")
    ids: bool = Field(default=False, description="Also write instance ids, as 16-bit PNG images. Default: no.")


def video_keys(options: LeRobotOptions) -> tuple[str, ...]:
    """Returns the names of the video features."""
    return (RGB, DEPTH) if options.depth else (RGB,)


def features_of(options: LeRobotOptions, fps: int, far_m: float) -> dict[str, Any]:
    """Returns the `features` of `info.json`."""
    side = FRAME_SIZE_PX
    found: dict[str, Any] = {
        RGB: {"dtype": "video", "shape": [side, side, 3], "names": _IMAGE_NAMES, "info": _rgb_info(fps)}
    }
    if options.depth:
        info = _depth_info(fps, far_m)
        found[DEPTH] = {"dtype": "video", "shape": [side, side, 1], "names": _IMAGE_NAMES, "info": info}
    if options.ids:
        found[IDS] = {"dtype": "image", "shape": [side, side, 1], "names": _IMAGE_NAMES}
    for name, (dtype, names) in VECTORS.items():
        found[name] = {"dtype": dtype, "shape": [len(names) if names else 1], "names": list(names) if names else None}
    return found


def data_schema(options: LeRobotOptions, list_type: Literal["List", "Sequence"] = "List") -> pa.Schema:
    """Returns the schema of the data files, with the feature description for `datasets`.

    Args:
        options: options of the export, which select columns.
        list_type: name of list features: `Sequence` before version 4 of `datasets`, which does not support `List`.
    """
    fields: list[pa.Field] = [pa.field(IDS, _IMAGE_TYPE)] if options.ids else []
    described: dict[str, Any] = {IDS: {"_type": "Image"}} if options.ids else {}
    for name, (dtype, names) in VECTORS.items():
        value = {"dtype": dtype, "_type": "Value"}
        if names is None:
            fields.append(pa.field(name, _TYPES[dtype]))
            described[name] = value
        else:
            fields.append(pa.field(name, pa.list_(pa.field("element", _TYPES[dtype]), len(names))))
            described[name] = {"feature": value, "length": len(names), "_type": list_type}
    metadata = {"huggingface": json.dumps({"info": {"features": described}})}
    return pa.schema(fields, metadata=metadata)


def _rgb_info(fps: int) -> dict[str, Any]:
    extra = {"video.crf": int(RGB_CODEC.options["crf"]), "video.extra_options": {"bf": 0}}
    return _video_info(RGB_CODEC, fps, 3) | extra | {"is_depth_map": False}


def _depth_info(fps: int, far_m: float) -> dict[str, Any]:
    quantiser = {"video.depth_min": 0.0, "video.depth_max": far_m, "video.shift": SHIFT_M, "video.use_log": True}
    extra = {"video.crf": None, "video.extra_options": {"x265-params": "lossless=1"}}
    return {"is_depth_map": True, "depth_unit": "m", **_video_info(DEPTH_CODEC, fps, 1), **extra, **quantiser}


def _video_info(codec: Codec, fps: int, channels: int) -> dict[str, Any]:
    return {
        "video.height": FRAME_SIZE_PX,
        "video.width": FRAME_SIZE_PX,
        "video.codec": codec.name,
        "video.pix_fmt": codec.pixels,
        "video.fps": fps,
        "video.channels": channels,
        "has_audio": False,
        "video.g": int(codec.options["g"]),
        "video.preset": codec.options["preset"],
        "video.fast_decode": 0,
        "video.video_backend": "pyav",
    }
