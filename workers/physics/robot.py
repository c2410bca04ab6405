"""Generates the URDF of the robot from the published dimensions of the Nova Carter (docs/design/robot.md).

Returns text only. Does not write or load a file, and copies no file of NVIDIA.
"""

from __future__ import annotations

from typing import NamedTuple

from schemas.config import RobotConfig

BASE_LINK = "base_link"
LEFT_WHEEL = "wheel_left"
RIGHT_WHEEL = "wheel_right"
CASTERS = ("caster_left", "caster_right")

_REAR_M, _FRONT_M = -0.607, 0.14  # the footprint along x, from base_link
_HALF_WIDTH_M = 0.25  # the footprint along y
_HULL_HALF_WIDTH_M = 0.16  # the narrow hull between the wheels
# heights of the underside, of the part where the body widens, and of the top
_CLEARANCE_M, _DECK_M, _TOP_M = 0.06, 0.305, 0.556
_CHASSIS_MASS_KG = 52.9
_CHASSIS_COM_M = (-0.21, 0.0, 0.283)
_CHASSIS_INERTIA = (0.969, 2.398, 2.513)
_CASTER_RADIUS_M = 0.0755
_CASTER_X_M, _CASTER_Y_M = -0.472, 0.1323


class _Box(NamedTuple):
    low: tuple[float, float, float]
    high: tuple[float, float, float]


def robot_urdf(robot: RobotConfig) -> str:
    """Returns the URDF text of the robot: base_link on the floor midway between the drive wheels, metres, kilograms.

    The wheels roll on spheres: a point contact follows the commanded speed to 0.2 %, a cylinder's edge does not
    (docs/design/robot.md#wheels-and-physics). A sphere is wider than the wheel, so spheres must collide with the floor
    only. The body collides with obstacles: the hull, the wider deck above it, and a guard around the drive wheels.
    """
    half_track = robot.track_m / 2
    return "\n".join(
        (
            '<robot name="carter">',
            f'<link name="{BASE_LINK}">',
            _inertial(_CHASSIS_MASS_KG, _CHASSIS_INERTIA, _CHASSIS_COM_M),
            *(_box_collision(box) for box in _body_boxes(robot.wheel_radius_m)),
            "</link>",
            *_wheel(LEFT_WHEEL, half_track, robot.wheel_radius_m),
            *_wheel(RIGHT_WHEEL, -half_track, robot.wheel_radius_m),
            *_caster(CASTERS[0], _CASTER_Y_M),
            *_caster(CASTERS[1], -_CASTER_Y_M),
            "</robot>",
        )
    )


def _body_boxes(wheel_radius: float) -> tuple[_Box, ...]:
    hull = _Box((_REAR_M, -_HULL_HALF_WIDTH_M, _CLEARANCE_M), (_FRONT_M, _HULL_HALF_WIDTH_M, _TOP_M))
    deck = _Box((_REAR_M, -_HALF_WIDTH_M, _DECK_M), (_FRONT_M, _HALF_WIDTH_M, _TOP_M))
    guard = _Box((-wheel_radius, -_HALF_WIDTH_M, _CLEARANCE_M), (_FRONT_M, _HALF_WIDTH_M, _DECK_M))
    return hull, deck, guard


def _wheel(name: str, y: float, radius: float) -> tuple[str, ...]:
    return (
        f'<link name="{name}">',
        _inertial(1.0, (0.0039, 0.0071, 0.0039)),
        _sphere_collision(radius),
        "</link>",
        _joint(name, "continuous", (0.0, y, radius)),
    )


def _caster(name: str, y: float) -> tuple[str, ...]:
    return (
        f'<link name="{name}">',
        _inertial(0.45, (0.0005, 0.0005, 0.0005)),
        _sphere_collision(_CASTER_RADIUS_M),
        "</link>",
        _joint(name, "fixed", (_CASTER_X_M, y, _CASTER_RADIUS_M)),
    )


def _inertial(mass: float, inertia: tuple[float, float, float], centre: tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    ixx, iyy, izz = inertia
    return (
        f'<inertial><origin xyz="{_numbers(centre)}"/><mass value="{mass:.9g}"/>'
        f'<inertia ixx="{ixx:.9g}" ixy="0" ixz="0" iyy="{iyy:.9g}" iyz="0" izz="{izz:.9g}"/></inertial>'
    )


def _box_collision(box: _Box) -> str:
    centre = tuple((low + high) / 2 for low, high in zip(box.low, box.high, strict=True))
    size = tuple(high - low for low, high in zip(box.low, box.high, strict=True))
    shape = f'<box size="{_numbers(size)}"/>'
    return f'<collision><origin xyz="{_numbers(centre)}"/><geometry>{shape}</geometry></collision>'


def _sphere_collision(radius: float) -> str:
    return f'<collision><geometry><sphere radius="{radius:.9g}"/></geometry></collision>'


def _joint(child: str, kind: str, origin: tuple[float, float, float]) -> str:
    return (
        f'<joint name="joint_{child}" type="{kind}"><parent link="{BASE_LINK}"/><child link="{child}"/>'
        f'<origin xyz="{_numbers(origin)}"/><axis xyz="0 1 0"/><dynamics damping="0" friction="0"/></joint>'
    )


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
