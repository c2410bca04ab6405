"""Plans of the faces that a camera is rendered from: one for each lens, with bounded sizes and normalised weights."""

from __future__ import annotations

import numpy as np
import pytest

from schemas.errors import UsageError
from schemas.rig import EquirectangularCamera, FisheyeCamera, Mount, PinholeCamera
from schemas.rig.rig_file import load_rig
from workers.geometry.faces import plan_faces


def test_cameras_with_equal_lenses_share_a_plan_of_faces():
    one, *others = [camera for camera in load_rig("nova-carter").cameras if isinstance(camera, FisheyeCamera)]
    assert len(others) == 3
    assert all(plan_faces(other) is plan_faces(one) for other in others)


def test_a_pinhole_camera_without_distortion_is_rendered_from_a_single_face():
    camera = PinholeCamera(name="front", model="pinhole", width=64, height=48, fx_px=40, cx_px=20, mount=Mount(z_m=1))
    plan = plan_faces(camera)
    (face,) = plan.faces
    assert plan.sampling is None
    assert (plan.width, plan.height) == (64, 48)
    assert face.view.focal_px == pytest.approx((40, 40))
    assert face.view.centre == (20, 24)


@pytest.mark.parametrize(("fov_deg", "faces"), [(120, 1), (160, 5), (200, 5), (320, 6)])
def test_a_fisheye_camera_has_as_many_faces_as_it_needs(fov_deg: float, faces: int):
    plan = plan_faces(FisheyeCamera(name="eye", model="fisheye", width=64, height=64, fov_deg=fov_deg))
    assert len(plan.faces) == faces


def test_weights_of_every_pixel_add_up_to_256_and_samples_are_inside_the_atlas():
    plan = plan_faces(EquirectangularCamera(name="around", model="equirectangular", width=64, height=32))
    sampling = plan.sampling
    assert sampling is not None
    assert (sampling.weights.sum(axis=0) == 256).all()
    assert sampling.first.min() >= 0
    assert sampling.first.max() + plan.width + 1 < plan.width * plan.height
    assert np.ptp(sampling.nearest) < plan.width * plan.height


def test_a_panorama_with_narrow_columns_keeps_their_resolution():
    plan = plan_faces(EquirectangularCamera(name="around", model="equirectangular", width=256, height=32))
    assert plan.faces[0].view.focal_px[0] == pytest.approx(256 / (2 * np.pi), rel=0.01)


def test_a_camera_that_needs_too_large_faces_is_refused():
    strip = EquirectangularCamera(
        name="strip", model="equirectangular", width=16, height=2048, top_deg=1, bottom_deg=0
    )  # fmt: skip
    with pytest.raises(UsageError, match=r"camera of 16 x 2048 pixels has up to \d+ pixels per radian.*reduce its"):
        plan_faces(strip)
