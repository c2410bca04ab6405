"""Parameters of sensor noise; a sensor without noise has the value `null`."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from schemas.base import Fraction, Model, Positive

_Gain = Annotated[float, Field(ge=0.01, le=100)]


class _TriangulationNoise(Model):
    range_min_m: Positive
    """Shortest measured depth, metres."""
    range_max_m: Positive
    """Longest measured depth, metres."""
    second_view: Literal["left", "right"] = "right"
    """Side of this camera on which the second camera or the projector is."""
    window_px: Annotated[int, Field(ge=3, le=65)] = 9
    """Side of the matching window, pixels; a pixel whose window contains a depth edge may have no measurement
    (`edge_dropout`)."""
    edge_dropout: Fraction = 0.5
    """Share of the pixels at depth edges that have no measurement."""

    @model_validator(mode="after")
    def _range_is_ordered(self) -> Self:
        if self.range_min_m >= self.range_max_m:
            raise ValueError(
                f"range_min_m {self.range_min_m:g} must be less than range_max_m {self.range_max_m:g}: swap them"
            )
        return self


class StereoDepthNoise(_TriangulationNoise):
    """Noise of depth from a stereo pair; by default the front pair of the Nova Carter with an Intel D4 matcher."""

    model: Literal["stereo"]
    """Noise model."""
    baseline_m: Positive = 0.15
    """Distance between the two cameras, metres."""
    disparity_std_px: Annotated[float, Field(ge=0, le=16)] = 0.1
    """Standard deviation of the disparity, pixels; the usual value of a textured surface (Grunnet-Jepsen et al.,
    "Tuning depth cameras for best performance", Intel RealSense)."""
    disparity_step_px: Annotated[float, Field(ge=0, le=16)] = 0.03125
    """Resolution of the disparity, pixels; 1/32 (Grunnet-Jepsen et al., "Subpixel linearity improvement", Intel
    RealSense); 0 does not round."""
    shift_std_px: Annotated[float, Field(ge=0, le=4)] = 0.0
    """Standard deviation of the lateral displacement of a pixel, pixels."""
    hole_share: Fraction = 0.02
    """Share of all pixels that have no measurement because of holes, as on surfaces without texture."""
    range_min_m: Positive = 0.3
    """Shortest measured depth, metres."""
    range_max_m: Positive = 10.0
    """Longest measured depth, metres."""


class StructuredLightNoise(_TriangulationNoise):
    """Noise of depth from structured light; by default the first Kinect (Handa et al., ICRA 2014, and its program)."""

    model: Literal["structured_light"]
    """Noise model."""
    baseline_m: Positive = 0.075
    """Distance between projector and camera, metres."""
    disparity_std_px: Annotated[float, Field(ge=0, le=16)] = 0.0208
    """Standard deviation of the disparity, pixels; a sixth of a step."""
    disparity_step_px: Annotated[float, Field(ge=0, le=16)] = 0.125
    """Resolution of the disparity, pixels; 0 does not round."""
    shift_std_px: Annotated[float, Field(ge=0, le=4)] = 0.5
    """Standard deviation of the lateral displacement of a pixel, pixels."""
    hole_share: Fraction = 0.0
    """Share of all pixels that have no measurement because of holes, as on surfaces that absorb the light."""
    range_min_m: Positive = 0.5
    """Shortest measured depth, metres."""
    range_max_m: Positive = 5.0
    """Longest measured depth, metres."""


DepthNoise = Annotated[StereoDepthNoise | StructuredLightNoise, Field(discriminator="model")]
"""Noise of depth, of any kind."""


class ColourNoise(Model):
    """Noise and processing of a colour image, in the order of the fields."""

    exposure_stops: Annotated[float, Field(ge=-8, le=8)] = 0.0
    """Exposure, stops; 1 doubles the light."""
    exposure_std_stops: Annotated[float, Field(ge=0, le=4)] = 0.0
    """Standard deviation of the exposure between episodes, stops."""
    white_balance: tuple[_Gain, _Gain, _Gain] = (1.0, 1.0, 1.0)
    """Gains of red, green and blue."""
    white_balance_std_stops: Annotated[float, Field(ge=0, le=2)] = 0.0
    """Standard deviation of the gains of red and blue between episodes, stops."""
    motion_blur_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Exposure time of a row, over which motion blurs the image, seconds."""
    rolling_shutter_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Time from the first row to the last one, seconds."""
    shutter_images: Annotated[int, Field(ge=2, le=64)] = 8
    """Number of images that are rendered and mixed if there is motion blur or a rolling shutter."""
    has_electrons: bool = True
    """Whether the image has shot noise and read noise."""
    full_well_e: Annotated[float, Field(ge=10, le=1e7)] = 10_700
    """Electrons of a saturated pixel at a gain of 0 dB; by default those of a Sony IMX255, whose signal-to-noise ratio
    is 40.3 dB (Matrix Vision, mvBlueFOX3 technical manual)."""
    read_noise_e: Annotated[float, Field(ge=0, le=1e5)] = 2.9
    """Standard deviation of the read noise, electrons; by default that of a Sony IMX255, whose dynamic range is
    71.3 dB."""
    gain_db: Annotated[float, Field(ge=0, le=60)] = 12.0
    """Analogue gain, decibels. 12 dB suits indoor light; a pixel is then saturated by a quarter of `full_well_e`."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """Quality of JPEG compression; null means no compression."""


class CameraNoise(Model):
    """Noise of a camera."""

    colour: ColourNoise | None = None
    """Noise of colour; null means no noise."""
    depth: DepthNoise | None = None
    """Noise of depth; null means no noise."""


class LidarNoise(Model):
    """Noise of a lidar; by default a Velodyne VLP-16."""

    range_std_m: Annotated[float, Field(ge=0, le=10)] = 0.008
    """Standard deviation of the range, metres (value of velodyne_simulator by Dataspeed Inc.)."""
    range_std_share: Fraction = 0.0
    """Standard deviation of the range, share of the range; added to `range_std_m` in quadrature."""
    range_step_m: Annotated[float, Field(ge=0, le=1)] = 0.002
    """Resolution of the range, metres (VLP-16 User Manual 63-9243, Sec. 9.3); 0 does not round."""
    matt_range_m: Positive | None = 100.0
    """Longest range at which a matt surface that faces the lidar is measured, metres (the same manual). At another
    angle of incidence, it is multiplied by the square root of the cosine of the angle. Null means no such limit."""
    dropout: Fraction = 0.0
    """Share of the rays that give no measurement."""
    sweep_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Duration of a scan, during which the robot moves, seconds; 0 casts all rays from the pose at the end of the
    scan, as after motion compensation."""


class ImuNoise(Model):
    """Noise of an IMU: white noise and a random walk of the bias; by default an Analog Devices ADIS16448."""

    gyro_white: Annotated[float, Field(ge=0, le=10)] = 2.36e-4
    """Noise density of the gyroscope, rad/s/sqrt(Hz); 0.0135 deg/s/sqrt(Hz) in the data sheet."""
    gyro_walk: Annotated[float, Field(ge=0, le=10)] = 4.0e-6
    """Random walk of the gyroscope's bias, rad/s2/sqrt(Hz); Kalibr's value for this IMU."""
    gyro_bias_std: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard deviation of the gyroscope's bias at the start, rad/s; 0 after a calibration at rest."""
    accelerometer_white: Annotated[float, Field(ge=0, le=100)] = 2.26e-3
    """Noise density of the accelerometer, m/s2/sqrt(Hz); 0.23 mg/sqrt(Hz) in the data sheet."""
    accelerometer_walk: Annotated[float, Field(ge=0, le=100)] = 2.0e-4
    """Random walk of the accelerometer's bias, m/s3/sqrt(Hz); Kalibr's value for this IMU."""
    accelerometer_bias_std: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of the accelerometer's bias at the start, m/s2."""


class OdometryNoise(Model):
    """Noise of wheel odometry; the defaults are assumptions, because no source has values for this robot."""

    slip_std_m: Annotated[float, Field(ge=0, le=1)] = 0.001
    """Standard deviation of the slip of each wheel after one metre, metres; it grows with the square root of the
    distance."""
    radius_error_std: Annotated[float, Field(ge=0, le=0.2)] = 0.001
    """Standard deviation of the wheel radii between episodes, share of the radius."""
