"""Pictures of optical flow and of scans: colours and places."""

from __future__ import annotations

import numpy as np

from factory.visualize.rig_sheet import show_flow, show_scan
from schemas.rig import Lidar2d, Mount
from workers.sensors import LidarScan


def test_the_hue_of_the_flow_is_its_direction_and_undefined_pixels_are_black() -> None:
    flow = np.zeros((1, 5, 2), np.float32)
    flow[0, :4] = ((4, 0), (0, 4), (-4, 0), (0, 0))
    flow[0, 4] = np.nan
    right, down, left, still, undefined = show_flow(flow)[0].astype(int).tolist()
    assert right == [255, 0, 0]
    assert down[1] == max(down) > down[2]  # green and yellow: a quarter of the wheel
    assert left[0] < 10 < 200 < min(left[1:])  # cyan: half of the wheel
    assert still == [255, 255, 255]
    assert undefined == [0, 0, 0]


def test_a_scan_is_drawn_where_its_mount_places_it() -> None:
    lidar = Lidar2d(
        name="scan", model="lidar2d", samples=4, range_min_m=0.1, range_max_m=9, mount=Mount(z_m=1, yaw_deg=90)
    )
    ranges = np.array(((0, 0, 4.05, 0),), np.float32)  # one return ahead of the sensor, to the left of the robot
    scan = LidarScan(ranges, np.array(((0, 0, 7, 0),), np.uint16), np.ones((1, 4), np.float32))
    pixels = np.asarray(show_scan(scan, lidar, 7, 160))
    rows, columns = np.nonzero((pixels == (255, 40, 40)).all(axis=-1))
    assert (columns.tolist(), abs(rows[0] - 80) <= 1) == ([39], True)
