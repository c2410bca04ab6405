"""The URDF of the robot: well formed, with the dimensions of the configuration."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from schemas.config import RobotConfig
from workers.physics.robot import BASE_LINK, CASTERS, LEFT_WHEEL, RIGHT_WHEEL, robot_urdf


def parse(robot: RobotConfig) -> ET.Element:
    return ET.fromstring(robot_urdf(robot))


def numbers(element: ET.Element | None, attribute: str) -> list[float]:
    assert element is not None
    return [float(word) for word in element.attrib[attribute].split()]


def body_extent(robot: ET.Element, axis: int) -> tuple[float, float]:
    ends = []
    for collision in robot.findall(f"link[@name='{BASE_LINK}']/collision"):
        centre = numbers(collision.find("origin"), "xyz")[axis]
        half = numbers(collision.find("geometry/box"), "size")[axis] / 2
        ends += [centre - half, centre + half]
    return min(ends), max(ends)


def test_urdf_names_body_wheels_and_casters() -> None:
    names = {link.attrib["name"] for link in parse(RobotConfig()).iter("link")}
    assert names == {BASE_LINK, LEFT_WHEEL, RIGHT_WHEEL, *CASTERS}


def test_wheels_are_one_track_width_apart_and_touch_the_floor() -> None:
    robot = parse(RobotConfig(track_m=0.52, wheel_radius_m=0.2))
    left, right = (numbers(robot.find(f"joint[@name='joint_{w}']/origin"), "xyz") for w in (LEFT_WHEEL, RIGHT_WHEEL))
    assert left[1] - right[1] == pytest.approx(0.52)
    assert left[2] == right[2] == 0.2
    assert numbers(robot.find(f"link[@name='{LEFT_WHEEL}']/collision/geometry/sphere"), "radius") == [0.2]


def test_the_left_wheel_is_on_the_left() -> None:
    assert numbers(parse(RobotConfig()).find(f"joint[@name='joint_{LEFT_WHEEL}']/origin"), "xyz")[1] > 0


def test_casters_touch_the_floor() -> None:
    robot = parse(RobotConfig())
    for caster in CASTERS:
        height = numbers(robot.find(f"joint[@name='joint_{caster}']/origin"), "xyz")[2]
        radius = numbers(robot.find(f"link[@name='{caster}']/collision/geometry/sphere"), "radius")[0]
        assert height == radius


def test_body_fills_the_published_footprint_and_clears_the_floor() -> None:
    robot = parse(RobotConfig())
    assert body_extent(robot, 0) == pytest.approx((-0.607, 0.14))
    assert body_extent(robot, 1) == pytest.approx((-0.25, 0.25))
    assert body_extent(robot, 2) == pytest.approx((0.06, 0.556))


def test_same_configuration_gives_same_text() -> None:
    assert robot_urdf(RobotConfig()) == robot_urdf(RobotConfig())
