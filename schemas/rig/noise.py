"""Parameters of sensor noise. Adds no noise; a sensor without noise has null."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from schemas.base import Fraction, Model, NonNegative, Positive


class StereoDepthNoise(Model):
    """Noise of depth from a stereo pair: Gaussian in disparity, with dropouts at edges and holes."""

    model: Literal["stereo"]
    """Noise model."""
    baseline_m: Positive = 0.15
    """Distance between the two cameras, metres."""
    disparity_std_px: NonNegative = 0.2
    """Standard deviation of the disparity, pixels."""
    edge_dropout: Fraction = 0.5
    """Share of the pixels at depth edges without a measurement."""
    hole_share: Fraction = 0.0
    """Share of all pixels in holes."""


class StructuredLightNoise(Model):
    """Noise of depth from structured light: grows with the square of the distance, with quantised disparity."""

    model: Literal["structured_light"]
    """Noise model."""
    baseline_m: Positive = 0.075
    """Distance between projector and camera, metres."""
    disparity_std_px: NonNegative = 0.125
    """Standard deviation of the disparity, pixels."""
    disparity_step_px: NonNegative = 0.125
    """Resolution of the disparity, pixels."""
    edge_dropout: Fraction = 0.5
    """Share of the pixels at depth edges without a measurement."""


DepthNoise = Annotated[StereoDepthNoise | StructuredLightNoise, Field(discriminator="model")]
"""Any noise of depth."""


class ColourNoise(Model):
    """Noise and processing of a colour image, in the order of the fields."""

    exposure_stops: Annotated[float, Field(ge=-8, le=8)] = 0.0
    """Exposure, stops; 1 doubles the light."""
    exposure_std_stops: Annotated[float, Field(ge=0, le=4)] = 0.0
    """Standard deviation of the exposure between episodes, stops."""
    white_balance: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    """Gains of red, green and blue."""
    motion_blur_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Exposure time over which motion blurs the image, seconds."""
    rolling_shutter_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Time from the first row to the last one, seconds."""
    full_well_e: Positive | None = None
    """Electrons of a saturated pixel, which give the shot noise; null has none."""
    read_noise_e: NonNegative = 0.0
    """Standard deviation of the read noise, electrons."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """Quality of JPEG compression; null has none."""


class CameraNoise(Model):
    """Noise of a camera."""

    colour: ColourNoise | None = None
    """Noise of colour; null has none."""
    depth: DepthNoise | None = None
    """Noise of depth; null has none."""


class LidarNoise(Model):
    """Noise of a lidar."""

    range_std_m: NonNegative = 0.0
    """Standard deviation of the range, metres."""
    range_std_share: Fraction = 0.0
    """Standard deviation of the range, share of the range; added to `range_std_m` in quadrature."""
    dropout: Fraction = 0.0
    """Share of the rays without a measurement."""


class ImuNoise(Model):
    """Noise of an IMU: white noise and a random walk of the bias."""

    gyro_white: NonNegative = 0.0
    """Noise density of the gyroscope, rad/s/sqrt(Hz)."""
    gyro_walk: NonNegative = 0.0
    """Random walk of the gyroscope's bias, rad/s2/sqrt(Hz)."""
    gyro_bias_std: NonNegative = 0.0
    """Standard deviation of the gyroscope's bias at the start, rad/s."""
    accelerometer_white: NonNegative = 0.0
    """Noise density of the accelerometer, m/s2/sqrt(Hz)."""
    accelerometer_walk: NonNegative = 0.0
    """Random walk of the accelerometer's bias, m/s3/sqrt(Hz)."""
    accelerometer_bias_std: NonNegative = 0.0
    """Standard deviation of the accelerometer's bias at the start, m/s2."""


class OdometryNoise(Model):
    """Noise of wheel odometry."""

    slip_std: Fraction = 0.0
    """Standard deviation of the slip of each wheel, share of its travel in a step."""
    radius_error_std: Annotated[float, Field(ge=0, le=0.2)] = 0.0
    """Standard deviation of the wheel radii between episodes, share of the radius."""
