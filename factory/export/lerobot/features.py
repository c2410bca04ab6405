"""Describes the features of a LeRobot dataset for `info.json` and the parquet schemas; 12-bit codes of depth.

Pure functions. LeRobot 0.6 decodes the codes; their steps grow with the distance.
"""

from __future__ import annotations

import json
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from factory.export.lerobot.layout import Column, ImageFeature, Layout
from factory.export.origin import COLUMN as ORIGIN
from factory.export.video import DEPTH_CODEC, RGB_CODEC, Codec
from schemas.rig import CameraOutput

LARGEST_CODE = 4095
"""Largest 12-bit depth code."""
SHIFT_M = 3.5
"""Offset of the logarithm, metres. Code 0 is 0 m, which means no hit."""


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


_IMAGE_NAMES = ["height", "width", "channels"]
_TYPES = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
_IMAGE_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])


def features_of(layout: Layout, fps: int) -> dict[str, Any]:
    """Returns the `features` of `info.json`."""
    features: dict[str, Any] = {}
    for image in layout.images:
        shape = [image.height, image.width, image.channels]
        features[image.key] = {"dtype": "video" if image.is_video else "image", "shape": shape, "names": _IMAGE_NAMES}
        if image.is_video:
            features[image.key]["info"] = (
                _rgb_info(image, fps) if image.output is CameraOutput.RGB else _depth_info(image, fps)
            )
    for name, column in layout.columns.items():
        names = list(column.names) if column.names else None
        features[name] = {"dtype": column.dtype, "shape": list(column.shape) or [1], "names": names}
    # a column of the frames, because LeRobot's tools keep those, but drop the columns of `meta/episodes`
    features[ORIGIN] = {"dtype": "string", "shape": [1], "names": None}
    return features


def data_schema(layout: Layout, list_type: Literal["List", "Sequence"] = "List") -> pa.Schema:
    """Returns the schema of the data files, with the feature description for `datasets`.

    Args:
        layout: features of the export.
        list_type: name of list features: `Sequence` before version 4 of `datasets`, which does not support `List`.
    """
    fields = [pa.field(image.key, _IMAGE_TYPE) for image in layout.pictures]
    described: dict[str, Any] = {image.key: {"_type": "Image"} for image in layout.pictures}
    for name, column in layout.columns.items():
        fields.append(pa.field(name, _type_of(column)))
        described[name] = _described(column, list_type)
    fields.append(pa.field(ORIGIN, pa.string()))
    described[ORIGIN] = {"dtype": "string", "_type": "Value"}
    metadata = {"huggingface": json.dumps({"info": {"features": described}})}
    return pa.schema(fields, metadata=metadata)


def _type_of(column: Column) -> pa.DataType:
    value = _TYPES[column.dtype]
    match column.shape:
        case ():
            return value
        case (size,):
            return pa.list_(pa.field("element", value), size)
    return pa.list_(pa.list_(value))  # `datasets` stores an `Array2D` in this type


def _described(column: Column, list_type: str) -> dict[str, Any]:
    value = {"dtype": column.dtype, "_type": "Value"}
    match column.shape:
        case ():
            return value
        case (size,):
            return {"feature": value, "length": size, "_type": list_type}
    return {"shape": list(column.shape), "dtype": column.dtype, "_type": "Array2D"}


def _rgb_info(image: ImageFeature, fps: int) -> dict[str, Any]:
    extra = {"video.crf": int(RGB_CODEC.options["crf"]), "video.extra_options": {"bf": 0}}
    return _video_info(image, RGB_CODEC, fps) | extra | {"is_depth_map": False}


def _depth_info(image: ImageFeature, fps: int) -> dict[str, Any]:
    quantiser = {
        "video.depth_min": 0.0,
        "video.depth_max": image.largest_m,
        "video.shift": SHIFT_M,
        "video.use_log": True,
    }
    extra = {"video.crf": None, "video.extra_options": {"x265-params": "lossless=1"}}
    return {"is_depth_map": True, "depth_unit": "m", **_video_info(image, DEPTH_CODEC, fps), **extra, **quantiser}


def _video_info(image: ImageFeature, codec: Codec, fps: int) -> dict[str, Any]:
    return {
        "video.height": image.height,
        "video.width": image.width,
        "video.codec": codec.name,
        "video.pix_fmt": codec.pixels,
        "video.fps": fps,
        "video.channels": image.channels,
        "has_audio": False,
        "video.g": int(codec.options["g"]),
        "video.preset": codec.options["preset"],
        "video.fast_decode": 0,
        "video.video_backend": "pyav",
    }
