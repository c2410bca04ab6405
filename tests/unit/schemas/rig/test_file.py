"""Rig files: the built-in rigs, and the messages for every mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from schemas.builtin import BUILTIN_RIGS
from schemas.errors import InvalidRig, UsageError
from schemas.rig import FisheyeCamera, Lidar3d, PinholeCamera
from schemas.rig.rig_file import load_rig

CAMERA = """
[[sensors]]
name = "front"
model = "pinhole"
width = 64
height = 48
fov_deg = 90
mount = { x_m = 0.2, z_m = 0.5 }
"""


def mistakes(folder: Path, text: str, control_hz: int = 60) -> str:
    """Returns the error message of a rig file."""
    path = folder / "mine.toml"
    path.write_text(text)
    with pytest.raises(InvalidRig) as caught:
        load_rig(str(path), control_hz)
    return str(caught.value)


def changed(*lines: str) -> str:
    """Returns the rig with one camera, with other values of some keys or with new keys."""
    keys = [line.split("=")[0].strip() for line in lines]
    kept = [line for line in CAMERA.splitlines() if line.split("=")[0].strip() not in keys]
    return "\n".join((*kept, *lines))


@pytest.mark.parametrize("name", BUILTIN_RIGS)
def test_every_built_in_rig_is_valid_and_cites_its_sources(name: str):
    rig = load_rig(name)
    assert rig.name == name
    assert rig.summary
    assert rig.source


def test_nova_carter_has_a_stereo_pair_four_fisheyes_and_three_lidars():
    rig = load_rig("nova-carter")
    left, right = [camera for camera in rig.cameras if isinstance(camera, PinholeCamera)]
    assert left.mount.y_m - right.mount.y_m == pytest.approx(0.15)
    fisheyes = [camera for camera in rig.cameras if isinstance(camera, FisheyeCamera)]
    assert sorted(camera.mount.yaw_deg for camera in fisheyes) == [-90, 0, 90, 180]
    assert [sensor.model for sensor in rig.sensors].count("lidar2d") == 2
    (lidar,) = [sensor for sensor in rig.sensors if isinstance(sensor, Lidar3d)]
    assert len(lidar.elevations_deg) == 32


def test_a_rig_without_a_name_has_the_name_of_its_file(tmp_path: Path):
    path = tmp_path / "mine.toml"
    path.write_text(CAMERA)
    assert load_rig(str(path)).name == "mine"


def test_the_error_of_an_unknown_rig_lists_the_built_in_rigs_and_a_suggestion(tmp_path: Path):
    with pytest.raises(UsageError, match=r"no rig 'nova-cartr'.*paper, nova-carter.*did you mean 'nova-carter'"):
        load_rig("nova-cartr")
    with pytest.raises(UsageError, match="that is a directory; give a TOML file"):
        load_rig(str(tmp_path))
    with pytest.raises(UsageError, match="NUL"):
        load_rig("a\0b")


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (('model = "pinehole"',), "sensors[0]: unknown model 'pinehole'; valid: pinhole, fisheye, equirectangular"),
        (("mount = { x_m = 0.2, z_m = -0.1 }",), "sensor 'front' at (0.2, 0, -0.1) m is not above the floor: increase"),
        (("mount = { x_m = 0.2 }",), "is not above the floor"),
        (("mount = { x_m = 0.2, z_m = 11 }",), "sensors[0].pinhole.mount.z_m: Input should be less than or equal"),
        (("near_m = 5", "far_m = 2"), "near_m 5 must be less than far_m 2: swap them"),
        (("width = 0",), "greater than or equal to 8 (found 0)"),
        (("width = 100000",), "less than or equal to 4096 (found 100000)"),
        (("width = 4096", "height = 4096"), "4096 x 4096 pixels are too many"),
        (("fov_deg = 175",), "fov_deg: Input should be less than 170 (found 175)"),
        (("fx_px = 30",), "give either fov_deg or fx_px"),
        (("fy_px = 30",), "fy_px is given without fx_px"),
        (("cx_px = 5000",), "cx_px 5000 is far outside of the image"),
        (("distortion = [-0.5, 0, 0, 0, 0]",), "folds over within the image: reduce the coefficients"),
        (("distortion = [0, 0, 2, 0, 0]",), "folds over within the image"),
        (("distortion = [nan, 0, 0, 0, 0]",), "finite number"),
        (('outputs = ["rgb", "rgb"]',), "name each output once"),
        (('outputs = ["colour"]',), "'rgb', 'depth', 'ids', 'normals' or 'flow'"),
        (("outputs = []",), "at least 1 item"),
        (("rate_hz = 0",), "greater than 0"),
        (("colour = 1",), "sensors[0].pinhole.colour: no such key"),
        (('model = "fisheye"', "fov_deg = 340"), "less than or equal to 320"),
        (('model = "fisheye"', "fov_deg = 190", 'depth = "axial"'), "depth 'axial' is not defined at 190 degrees"),
        (('model = "fisheye"', "fov_deg = 180", "distortion = [-0.3, 0, 0, 0]"), "folds over"),
        (('model = "lidar2d"',), "samples: Field required"),
    ],
)
def test_a_mistake_in_a_camera_is_named_with_its_remedy(tmp_path: Path, lines: tuple[str, ...], message: str):
    assert message in mistakes(tmp_path, changed(*lines))


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (("range_min_m = 12", "range_max_m = 0.1"), "range_min_m 12 must be less than range_max_m 0.1: swap them"),
        (("azimuth_min_deg = 90", "azimuth_max_deg = -90"), "azimuth_min_deg 90 must be less than azimuth_max_deg -90"),
        (("azimuth_min_deg = -360", "azimuth_max_deg = 90"), "span more than 360 degrees"),
        (("elevations_deg = [1, 1]",), "elevations_deg must decrease"),
        (("elevations_deg = [-1, 1]",), "elevations_deg must decrease"),
        (("elevations_deg = []",), "at least 1 item"),
        (("samples = 0",), "greater than or equal to 1"),
        (("samples = 60000", f"elevations_deg = {list(range(60, -60, -1))}"), "rays per scan are too many"),
    ],
)
def test_a_mistake_in_a_lidar_is_named_with_its_remedy(tmp_path: Path, lines: tuple[str, ...], message: str):
    given = {line.split("=")[0].strip(): line for line in lines}
    wanted = {"samples": "samples = 10", "range_min_m": "range_min_m = 0.1", "range_max_m": "range_max_m = 9",
              "elevations_deg": "elevations_deg = [1, 0]"} | given  # fmt: skip
    head = '[[sensors]]\nname = "top"\nmodel = "lidar3d"\nmount = { z_m = 1 }\n'
    assert message in mistakes(tmp_path, head + "\n".join(wanted.values()))


def test_the_error_of_a_rate_that_does_not_divide_the_control_rate_lists_the_rates_that_do(tmp_path: Path):
    message = mistakes(tmp_path, changed("rate_hz = 25"))
    assert "rate_hz 25 does not divide the control rate, 60 Hz (whole rates that do: 60, 30, 20, 15, 12, 10" in message
    assert "rate_hz 120 does not divide" in mistakes(tmp_path, changed("rate_hz = 120"))
    path = tmp_path / "slow.toml"
    path.write_text(changed("rate_hz = 7.5"))
    assert load_rig(str(path)).sensors[0].stride(60) == 8
    with pytest.raises(InvalidRig, match="control rate of 50 Hz"):
        load_rig("nova-carter", 50)


def test_a_camera_inside_the_body_is_refused_and_an_imu_is_not(tmp_path: Path):
    body = "body = [{ low_m = [-1, -1, 0], high_m = [1, 1, 1] }]\n"
    imu = '[[sensors]]\nname = "imu"\nmodel = "imu"\nmount = { z_m = 0.5 }\n'
    message = mistakes(tmp_path, body + CAMERA + imu)
    assert "sensor 'front' at (0.2, 0, 0.5) m is inside the robot, x -1 to 1, y -1 to 1, z 0 to 1 m: move it" in message
    assert "imu" not in message
    assert "must be less than high_m" in mistakes(tmp_path, body.replace("[1, 1, 1]", "[-1, 1, 1]") + CAMERA)


def test_all_mistakes_are_listed_together(tmp_path: Path):
    second = CAMERA.replace("z_m = 0.5", "z_m = -1").replace("fov_deg = 90", "fov_deg = 60")
    message = mistakes(tmp_path, CAMERA + second)
    assert "two sensors are named 'front': rename one" in message
    assert "is not above the floor" in message


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "sensors: Field required"),
        ("sensors = []", "sensors: Tuple should have at least 1 item"),
        ("[[sensors", "is not valid TOML"),
        ("sensors = 5", "sensors: expected a list"),
        ('[[sensors]]\nname = "a"', "Unable to extract tag using discriminator 'model'"),
        (f"{CAMERA}\n[more]\nx = 1", "more: no such key"),
        ("x = " + "[" * 100_000, "is not"),
    ],
)
def test_a_file_that_is_not_a_rig_is_refused(tmp_path: Path, text: str, message: str):
    assert message in mistakes(tmp_path, text)


def test_a_rig_has_a_bounded_number_of_sensors(tmp_path: Path):
    many = "".join(CAMERA.replace('"front"', f'"front_{number}"') for number in range(33))
    assert "at most 32 items" in mistakes(tmp_path, many)
