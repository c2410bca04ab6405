"""The choice of views and objects for pictures, before rendering."""

from __future__ import annotations

import numpy as np
import pytest

from factory.scenes.pictures.sheet import alone, known_colours, model_name, variants
from factory.scenes.pictures.viewpoints import EYE, looking, score_view, try_views
from schemas.frame import Frame
from tests.builders.scene import box_room
from workers.geometry.camera import optical_pose


def frame(ids: np.ndarray, depth_m: float = 3.0) -> Frame:
    return Frame(np.zeros((*ids.shape, 3), np.uint8), np.full(ids.shape, depth_m, np.float32), ids.astype(np.uint16))


def picture(*things: int) -> np.ndarray:
    """40 x 40 ids: background 1 and one square of 8 x 8 for each object."""
    ids = np.ones((40, 40), int)
    for number, thing in enumerate(things):
        ids[4:12, 9 * number : 9 * number + 8] = thing
    return ids


def test_a_view_of_more_targets_has_a_higher_score() -> None:
    targets = frozenset({5, 6, 7})
    assert (
        score_view(frame(picture(5, 6)), targets)
        > score_view(frame(picture(5)), targets)
        > score_view(frame(picture()), targets)
    )


def test_new_targets_score_higher_than_clutter_and_seen_targets() -> None:
    look = frame(picture(5))
    assert score_view(look, frozenset({5})) > score_view(look, frozenset())
    assert score_view(look, frozenset({5})) > score_view(look, frozenset({5}), seen={5})


def test_an_object_close_to_the_camera_lowers_the_score() -> None:
    look, near = picture(5, 6), frame(picture(5, 6), 0.3)
    assert score_view(near, frozenset({5, 6})) < 0.5 * score_view(frame(look), frozenset({5, 6}))


def test_a_view_has_the_requested_heading() -> None:
    view = looking(np.array((1.0, 2.0, 1.5)), np.pi / 2, np.radians(-30), 60.0)
    optical = optical_pose(view.pose, view.camera)
    assert optical.eye == pytest.approx((1.0, 2.0, 1.5), abs=1e-5)
    assert optical.rotation[:, 2] == pytest.approx((0.0, np.cos(np.radians(30)), -0.5), abs=1e-6)
    assert optical.rotation[2, 0] == pytest.approx(0.0, abs=1e-9)


def test_views_are_at_surveyed_points_at_eye_height_or_on_the_robot() -> None:
    scene = box_room()
    standing, driving = list(try_views(scene, EYE, places=2)), list(try_views(scene, None, places=2))
    assert {(view.pose.x, view.pose.y) for view in standing} <= {tuple(point) for point in scene.spawns.astype(float)}
    assert {view.pose.z for view in standing} == {scene.info.floor_height_m + EYE.eye_m}
    assert {view.pose.z for view in driving} == {scene.info.floor_height_m}


def test_an_isolated_object_keeps_only_its_triangles() -> None:
    scene = box_room()
    target = scene.info.targets[0]
    single = alone(scene, target.instance_id)
    assert set(single.part_instance.tolist()) == {target.instance_id}
    assert (
        single.part_count.sum()
        == len(single.positions)
        == scene.part_count[scene.part_instance == target.instance_id].sum()
    )
    low, high = single.positions.min(axis=0), single.positions.max(axis=0)
    assert (low + high) / 2 == pytest.approx(np.array(target.centroid_m), abs=0.05)


def test_each_model_and_colour_is_shown_once() -> None:
    one = box_room().info.targets[0]
    twin = one.model_copy(update={"target_id": "twin", "prim_path": one.prim_path + "_7"})
    other = one.model_copy(update={"target_id": "other", "colour": "purple"})
    assert model_name("/World/Props/SM_Chair_A_02_17") == "SM_Chair_A_02"
    assert len(variants([one, one, other])) == 2
    assert len(variants([one, twin, other], most=1)) == 1


def test_only_objects_with_a_colour_name_are_on_the_check_sheet() -> None:
    one = box_room().info.targets[0]
    rows = [one.model_copy(update={"target_id": f"t{n}", "colour": "red" if n % 2 else "unknown"}) for n in range(9)]
    sample = known_colours(rows, 3, np.random.default_rng(1))
    assert len(sample) == 3
    assert {target.colour for target in sample} == {"red"}
    assert known_colours([rows[0]], 3, np.random.default_rng(1)) == []
