"""Bounds of noise parameters, and cameras that do not support depth noise."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from schemas.rig.cameras import Camera
from schemas.rig.noise import (
    CameraNoise,
    ColourNoise,
    ImuNoise,
    LidarNoise,
    OdometryNoise,
    StereoDepthNoise,
    StructuredLightNoise,
)

MODELS = (ColourNoise, ImuNoise, LidarNoise, OdometryNoise, StereoDepthNoise, StructuredLightNoise)
FIELDS = [
    pytest.param(model, name, id=f"{model.__name__}.{name}")
    for model in MODELS
    for name, field in model.model_fields.items()
    if field.annotation is float or field.annotation is int
]


def make(model: type[Any], **fields: object) -> Any:
    kind = {"StereoDepthNoise": "stereo", "StructuredLightNoise": "structured_light"}.get(model.__name__)
    return model.model_validate(({"model": kind} if kind else {}) | fields)


@pytest.mark.parametrize(("model", "name"), FIELDS)
@pytest.mark.parametrize("value", [-1e9, 1e12, float("nan"), float("inf"), "much", [1, 2]])
def test_each_number_of_each_noise_model_has_bounds(model: type[Any], name: str, value: object) -> None:
    with pytest.raises(ValidationError, match=name):
        make(model, **{name: value})


@pytest.mark.parametrize("model", [StereoDepthNoise, StructuredLightNoise])
def test_inverted_depth_ranges_are_rejected_with_a_remedy(model: type[Any]) -> None:
    with pytest.raises(ValidationError, match="range_min_m 3 must be less than range_max_m 2: swap them"):
        make(model, range_min_m=3, range_max_m=2)


@pytest.mark.parametrize(
    "camera",
    [
        {"model": "fisheye", "fov_deg": 180},
        {"model": "equirectangular"},
        {"model": "pinhole", "fov_deg": 90, "depth": "radial"},
        {"model": "pinhole", "fov_deg": 90, "distortion": (0.1, 0, 0, 0, 0)},
    ],
    ids=["fisheye", "panorama", "radial", "distorted"],
)
def test_depth_noise_needs_a_camera_with_rectified_images(camera: dict[str, object]) -> None:
    adapter = TypeAdapter[Any](Camera)
    data = {"name": "c", "width": 64, "height": 64, **camera}
    adapter.validate_python(data)
    noise = CameraNoise(depth=StereoDepthNoise(model="stereo"))
    with pytest.raises(ValidationError, match=r"noise\.depth needs model 'pinhole'"):
        adapter.validate_python(data | {"noise": noise})
