"""Contract suite of renderers: required output of each renderer, and agreement between renderers."""

from __future__ import annotations

import hashlib
import itertools
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import structlog

from schemas.config import CameraConfig, TaskConfig
from schemas.encoding.arrays import DEPTH_FRAME, IDS_FRAME, RGB_FRAME
from schemas.errors import UsageError, WorldError
from schemas.frame import Frame
from schemas.scene import TEXTURE_SIZE_PX, CompiledScene, Sky
from schemas.support.stage_timer import StageTimer
from schemas.terms import RendererKind
from tests.builders.bundle import job_for
from tests.builders.scene import Box, box_room, build_scene, room_walls
from workers.experts.observation import Observation
from workers.geometry.pose import Pose
from workers.render import PartialRenderer, Renderer, Window
from workers.render import choose as choose_module
from workers.render.choose import open_renderer

CAMERA = CameraConfig()
ORIGIN = Pose.planar(0.0, 0.0, 0.0)
RED, BLUE = (200, 30, 30), (30, 30, 200)


def look(renderer: Renderer, *boxes: Box, pose: Pose = ORIGIN) -> Frame:
    renderer.load(build_scene(boxes), CAMERA)
    return renderer.render(pose)


def wall(x: float, colour: tuple[int, int, int] = RED) -> Box:
    return Box((x, -40.0, -40.0), (x + 0.1, 40.0, 40.0), colour)


def furnished_room() -> CompiledScene:
    """The box room with a checkerboard on its wall and a box below the height of the camera."""
    rows, columns = np.mgrid[:TEXTURE_SIZE_PX, :TEXTURE_SIZE_PX] // 64
    board = np.where((rows + columns)[..., None] % 2, 255, 80).astype(np.uint8)
    chequers = np.broadcast_to(board, (1, TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3))
    boxes = (
        *room_walls((-4.0, -3.0), (4.0, 3.0)),
        Box((3.9, -1.5, 0.3), (3.95, -0.5, 1.3), (255, 255, 255), texture=0),
        Box((1.0, -0.4, 0.0), (1.5, 0.2, 0.25), RED, category="crate"),
        Box((2.2, 1.0, 0.0), (2.8, 1.6, 0.6), BLUE, category="barrel"),
    )
    return build_scene(boxes, textures=chequers)


def test_frames_fit_their_specs(renderer: Renderer) -> None:
    renderer.load(box_room(), CAMERA)
    frame = renderer.render(ORIGIN)
    findings = (RGB_FRAME.violations(frame.rgb), DEPTH_FRAME.violations(frame.depth), IDS_FRAME.violations(frame.ids))
    assert findings == ([], [], [])
    assert all(array.flags.c_contiguous and array.flags.owndata for array in (frame.rgb, frame.depth, frame.ids))


def test_a_wall_has_its_known_depth_everywhere(renderer: Renderer) -> None:
    frame = look(renderer, wall(3.1003))
    assert frame.depth == pytest.approx(3.0, abs=1e-3)
    assert (frame.ids == 1).all()
    assert (frame.rgb == RED).all()


def test_the_image_is_neither_mirrored_nor_upside_down(renderer: Renderer) -> None:
    frame = look(renderer, Box((3, 0.5, 1.0), (4, 1.5, 2.0), RED), Box((3, -1.5, -1.0), (4, -0.5, -0.2), BLUE))
    rows, columns = np.nonzero(frame.ids == 1)
    assert (rows.max() < 320, columns.max() < 320) == (True, True)
    rows, columns = np.nonzero(frame.ids == 2)
    assert (rows.min() >= 320, columns.min() >= 320) == (True, True)
    assert (frame.rgb[frame.ids == 2] == BLUE).all()


def test_an_edge_is_projected_to_its_pinhole_pixel(renderer: Renderer) -> None:
    front = 2.0 + CAMERA.x_m
    box = Box((front, CAMERA.y_m - 0.5, CAMERA.z_m - 0.25), (front + 1, CAMERA.y_m + 1.0, CAMERA.z_m + 0.75))
    rows, columns = np.nonzero(look(renderer, box).ids)
    edges = [columns.min(), columns.max() + 1, rows.min(), rows.max() + 1]
    assert edges == pytest.approx([320 - 160, 320 + 80, 320 - 120, 320 + 40], abs=1)


def test_the_nearer_of_two_objects_is_visible(renderer: Renderer) -> None:
    frame = look(renderer, wall(5.0), Box((2, -0.5, 0), (2.5, 0.5, 1), BLUE))
    assert frame.ids[320, 320] == 2
    assert frame.depth[320, 320] == pytest.approx(2.0 - CAMERA.x_m, abs=1e-3)


def test_an_empty_view_has_zero_depth_and_id(renderer: Renderer) -> None:
    frame = look(renderer, wall(-2.0))
    assert not any(array.any() for array in (frame.rgb, frame.depth, frame.ids))


def test_an_empty_view_keeps_no_pixels_of_the_previous_frame(renderer: Renderer) -> None:
    renderer.load(furnished_room(), CAMERA)
    renderer.render(ORIGIN)
    frame = look(renderer, Box((2.0, 0.5, -0.5), (2.5, 1.5, 0.5), RED))
    void = frame.depth == 0
    assert 0.5 < void.mean() < 1
    assert not frame.rgb[void].any()
    assert not frame.ids[void].any()
    assert frame.rgb[~void].any(axis=1).all()
    assert frame.ids[~void].all()


def under(sky: Sky | None, scene: CompiledScene) -> CompiledScene:
    return replace(scene, info=scene.info.model_copy(update={"sky": sky}))


SKY = Sky(zenith=(0, 0, 250), horizon=(200, 210, 220), ground=(90, 80, 70))


def test_the_sky_is_visible_only_where_no_surface_is(renderer: Renderer) -> None:
    scene = build_scene([Box((2.0, -0.5, -0.5), (2.5, 0.5, 1.0), RED)])
    frames = []
    for sky in (None, SKY):
        renderer.load(under(sky, scene), CAMERA)
        frames.append(renderer.render(ORIGIN))
    black, blue = frames
    void = black.depth == 0
    np.testing.assert_array_equal(blue.depth, black.depth)
    np.testing.assert_array_equal(blue.ids, black.ids)
    np.testing.assert_array_equal(blue.rgb[~void], black.rgb[~void])
    column = blue.rgb[:, 0].astype(int)
    assert void[:, 0].all()
    assert column[319] == pytest.approx(SKY.horizon, abs=12)
    assert column[-1] == pytest.approx(SKY.ground)
    assert (np.diff(column[:320, 0]) >= 0).all()
    assert column[0, 0] < 70


def test_the_sky_turns_with_the_tilt_of_the_camera_and_not_with_its_heading(renderer: Renderer) -> None:
    renderer.load(under(SKY, build_scene([wall(-2.0)])), CAMERA)
    ahead, aside = (renderer.render(Pose.planar(0.0, 0.0, yaw)).rgb for yaw in (0.0, 0.6))
    up = renderer.render(Pose(0.0, 0.0, 0.0, float(np.cos(0.15)), 0.0, -float(np.sin(0.15)), 0.0)).rgb
    assert (np.abs(ahead.astype(int) - aside) <= 1).all()
    assert up[320, 320, 0] < ahead[320, 320, 0] - 20
    assert renderer.render(ORIGIN).rgb.tobytes() == ahead.tobytes()


def test_a_frame_of_a_closed_room_does_not_depend_on_the_sky(renderer: Renderer) -> None:
    roof = Box((-5.0, -4.0, 2.5), (5.0, 4.0, 2.6))
    room = build_scene([*room_walls((-4.0, -3.0), (4.0, 3.0)), roof])
    for yaw in (0.0, 1.1, 2.7):
        digests = set()
        for sky in (None, SKY):
            renderer.load(under(sky, room), CAMERA)
            digests.add(digest(renderer.render(Pose.planar(-1.0, 0.4, yaw))))
        assert len(digests) == 1


@pytest.mark.gl
def test_renderers_paint_the_same_sky() -> None:
    scene, pose = under(SKY, build_scene([Box((2.0, -0.5, -0.5), (2.5, 0.5, 1.0), RED)])), Pose.planar(0.2, 0.1, 0.4)
    with open_renderer("gl") as one, open_renderer("tiny") as other:
        for opened in (one, other):
            opened.load(scene, CAMERA)
        first, second = one.render(pose), other.render(pose)
    void = (first.depth == 0) & (second.depth == 0)
    assert void.mean() > 0.5
    np.testing.assert_array_equal(first.rgb[void], second.rgb[void])


def test_surfaces_beyond_the_clip_range_are_not_rendered(renderer: Renderer) -> None:
    frame = look(renderer, wall(30.5), Box((29.0, -1, 0), (29.5, 1, 1), BLUE))
    assert set(np.unique(frame.ids)) == {0, 2}
    assert (frame.depth[frame.ids == 0] == 0).all()
    assert (frame.rgb[frame.ids == 0] == 0).all()
    assert frame.depth.max() <= CAMERA.far_m


def test_a_surface_across_the_far_plane_is_cut_at_this_plane(renderer: Renderer) -> None:
    renderer.load(build_scene([wall(CAMERA.x_m + CAMERA.far_m)]), CAMERA)
    for yaw_rad in (-2e-4, -1e-4, 1e-4, 2e-4):  # the wall crosses the far plane within the image
        depth = renderer.render(Pose.planar(0.0, 0.0, yaw_rad)).depth
        assert 0.3 < np.count_nonzero(depth) / depth.size < 0.7
        assert DEPTH_FRAME.violations(depth) == []


@pytest.mark.gl
def test_far_depth_has_float_resolution() -> None:
    """OpenGL only: TinyRenderer's depth buffer has 24 bits."""
    far = CAMERA.x_m + 29.0
    halves = (Box((far, -40, -40), (far + 1, 0, 40), RED), Box((far + 1e-4, 0, -40), (far + 1, 40, 40), BLUE))
    with open_renderer("gl") as renderer:
        depth = look(renderer, *halves).depth
    assert depth[:, 330:] == pytest.approx(29.0, abs=1e-5)
    assert depth[:, :310] == pytest.approx(29.0001, abs=1e-5)


def test_a_surface_through_the_camera_plane_has_the_correct_depth_in_front_of_the_camera(renderer: Renderer) -> None:
    frame = look(renderer, Box((-9, -9, -0.1), (9, 9, 0.0)))
    rows = np.arange(360, 640)
    expected = CAMERA.z_m * 320 / (rows + 0.5 - 320)
    assert frame.depth[rows, 320] == pytest.approx(expected, rel=0.005)


def test_back_faces_are_not_rendered(renderer: Renderer) -> None:
    assert not look(renderer, Box((-1, -1, -1), (1, 1, 1))).ids.any()


def test_textures_are_upright_and_multiply_the_colour(renderer: Renderer) -> None:
    layer = np.zeros((1, TEXTURE_SIZE_PX, TEXTURE_SIZE_PX, 3), np.uint8)
    layer[0, : TEXTURE_SIZE_PX // 2] = 255
    renderer.load(build_scene([Box((2, -1, 0), (3, 1, 1), (200, 100, 50), texture=0)], textures=layer), CAMERA)
    frame = renderer.render(ORIGIN)
    rows = np.nonzero(frame.ids[:, 320])[0]
    assert frame.rgb[rows[3], 320].tolist() == pytest.approx([200, 100, 50], abs=2)
    assert frame.rgb[rows[-4], 320].tolist() == [0, 0, 0]


@pytest.mark.gl
def test_corners_of_different_colours_are_blended() -> None:
    """OpenGL only: TinyRenderer has one colour per mesh."""
    scene = build_scene([Box((2.0, -2.0, -2.0), (2.1, 2.0, 3.0), RED)])
    on_the_left = scene.positions[:, 1] > 0
    with open_renderer("gl") as renderer:
        renderer.load(replace(scene, colours=np.where(on_the_left[:, None], RED, BLUE).astype(np.uint8)), CAMERA)
        red, _, blue = renderer.render(ORIGIN).rgb[320].astype(int).T
    assert red[20] > red[320] > red[-20]
    assert blue[20] < blue[320] < blue[-20]
    assert abs(int(red[320]) - 115) < 20


def test_baked_light_multiplies_the_colour(renderer: Renderer) -> None:
    scene = build_scene([wall(3.0)])
    light = np.full((2, 2, 3), (51, 102, 255), np.uint8)
    uvs = np.full((len(scene.positions), 2), 0.5, np.float32)
    renderer.load(replace(scene, light_uvs=uvs, light_map=light), CAMERA)
    frame = renderer.render(ORIGIN)
    assert frame.rgb[320, 320].tolist() == pytest.approx([RED[0] * 0.2, RED[1] * 0.4, RED[2]], abs=1)


@pytest.mark.gl
def test_the_first_row_of_the_light_map_is_at_v_0_and_texels_are_interpolated() -> None:
    scene = build_scene([wall(3.0)])
    light = np.array([[[0] * 3, [100] * 3], [[200] * 3, [200] * 3]], np.uint8)
    seen = []
    with open_renderer("gl") as opened:
        for place in ((0.25, 0.25), (0.75, 0.25), (0.5, 0.25), (0.25, 0.75)):
            uvs = np.tile(np.array(place, np.float32), (len(scene.positions), 1))
            opened.load(replace(scene, light_uvs=uvs, light_map=light), CAMERA)
            seen.append(opened.render(ORIGIN).rgb[320, 320, 0] / RED[0] * 255)
    assert seen == pytest.approx([0, 100, 50, 200], abs=2)


def test_the_same_pose_gives_the_same_bytes(renderer: Renderer) -> None:
    renderer.load(furnished_room(), CAMERA)
    pose = Pose.planar(-1.0, 0.4, 0.3)
    first = digest(renderer.render(pose))
    renderer.render(ORIGIN)
    assert digest(renderer.render(pose)) == first


def test_a_returned_frame_is_not_changed_by_the_next_rendering(renderer: Renderer) -> None:
    renderer.load(box_room(), CAMERA)
    first = renderer.render(ORIGIN)
    before = digest(first)
    renderer.render(Pose.planar(1.0, 1.0, 2.0))
    assert digest(first) == before


@pytest.mark.parametrize("size", [80, 128, 640, 1000])
def test_a_frame_of_any_size_has_the_same_field_of_view(renderer: Renderer, size: int) -> None:
    renderer.load(furnished_room(), CAMERA)
    pose = Pose.planar(-0.5, -0.3, 0.7)
    whole, frame = renderer.render(pose), renderer.render(pose, size)
    assert (frame.rgb.shape, frame.depth.shape, frame.ids.shape) == ((size, size, 3), (size, size), (size, size))
    nearest = ((np.arange(size) + 0.5) * 640 / size).astype(int)
    rows_columns = np.ix_(nearest, nearest)
    inner = ~is_edge(whole.ids)[rows_columns]
    assert (frame.ids == whole.ids[rows_columns])[inner].mean() >= 0.995
    assert (np.abs(frame.depth - whole.depth[rows_columns]) <= 0.05 + 0.02 * frame.depth)[inner].mean() >= 0.99


def test_a_frame_of_another_size_does_not_change_the_next_frame(renderer: Renderer) -> None:
    renderer.load(furnished_room(), CAMERA)
    first, depth_and_ids = digest(renderer.render(ORIGIN)), renderer.render_depth_and_ids(ORIGIN)
    small = digest(renderer.render(ORIGIN, 64))
    assert digest(renderer.render(ORIGIN)) == first
    np.testing.assert_array_equal(renderer.render_depth_and_ids(ORIGIN).depth, depth_and_ids.depth)
    assert digest(renderer.render(ORIGIN, 64)) == small


def test_scenes_can_be_switched_back_and_forth(renderer: Renderer) -> None:
    scenes = [build_scene([wall(2.0 + k)]) for k in range(6)]
    depths = []
    for scene in (*scenes, *scenes):
        renderer.load(scene, CAMERA)
        depths.append(float(renderer.render(ORIGIN).depth[320, 320]))
    assert depths == pytest.approx([2.0 + k - CAMERA.x_m for k in range(6)] * 2, abs=1e-3)


def test_another_camera_configuration_can_be_used(renderer: Renderer) -> None:
    scene = build_scene([wall(3.0)])
    renderer.load(scene, CAMERA.model_copy(update={"x_m": 1.0, "fov_deg": 60.0}))
    assert renderer.render(ORIGIN).depth[320, 320] == pytest.approx(2.0, abs=1e-3)


def test_rendering_without_a_scene_is_refused_with_the_remedy(new_renderer: Renderer) -> None:
    with pytest.raises(UsageError, match="load"):
        new_renderer.render(ORIGIN)


def test_closing_twice_has_no_effect(new_renderer: Renderer) -> None:
    new_renderer.load(box_room(), CAMERA)
    new_renderer.close()
    new_renderer.close()


def test_a_renderer_describes_itself(renderer: Renderer) -> None:
    assert len(renderer.description) > 5


@pytest.mark.gl
def test_two_open_renderers_do_not_affect_each_other() -> None:
    with open_renderer("gl") as one, open_renderer("gl") as two:
        one.load(build_scene([wall(2.0)]), CAMERA)
        two.load(build_scene([wall(3.0)]), CAMERA)
        depths = [float(each.render(ORIGIN).depth[0, 0]) for each in (one, two)]
    assert depths == pytest.approx([2.0 - CAMERA.x_m, 3.0 - CAMERA.x_m], abs=1e-3)


@pytest.mark.gl
@pytest.mark.parametrize("heading", [0.0, 0.7, 2.0, 3.6, 5.0])
def test_all_renderers_produce_the_same_frames(heading: float) -> None:
    """Ids agree on 99.5 % of the pixels. Away from id edges, 99.5 % of the depths agree within 1 cm + 0.5 %."""
    scene, pose = furnished_room(), Pose.planar(-0.5, -0.3, heading)
    with open_renderer("gl") as fast, open_renderer("tiny") as slow:
        fast.load(scene, CAMERA)
        slow.load(scene, CAMERA)
        a, b = fast.render(pose), slow.render(pose)
    assert (a.ids == b.ids).mean() >= 0.995
    inner = ~(is_edge(a.ids) | is_edge(b.ids))
    assert (np.abs(a.depth - b.depth) <= 0.01 + 0.005 * a.depth)[inner].mean() >= 0.995
    plain = inner & (a.ids != 6)
    assert np.abs(a.rgb.astype(int) - b.rgb)[plain].max() <= 2


def test_auto_falls_back_and_logs_the_missing_packages() -> None:
    def no_driver(size: int, timer: StageTimer) -> Renderer:
        raise WorldError("no driver here")

    with structlog.testing.capture_logs() as lines, choose_module.open_first(no_driver, 640) as opened:
        assert "Tiny" in opened.description
    assert [line["event"] for line in lines] == ["renderer_fallback"]
    assert "libegl1 libgl1-mesa-dri" in lines[0]["remedy"]


def test_an_unknown_renderer_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match="auto, gl, tiny"):
        open_renderer("vulkan")  # type: ignore[arg-type]
    assert get_args(RendererKind) == ("auto", "gl", "tiny")


def digest(frame: Frame) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in (frame.rgb, frame.depth, frame.ids))).hexdigest()


def is_edge(ids: np.ndarray) -> np.ndarray:
    """Returns which pixels have a different id than one of their four neighbours."""
    padded = np.pad(ids, 1, mode="edge")
    neighbours = (padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:])
    return np.asarray(np.any([other != ids for other in neighbours], axis=0))


def test_a_depth_and_id_frame_equals_the_frame_without_colour(renderer: Renderer) -> None:
    renderer.load(furnished_room(), CAMERA)
    for pose in (ORIGIN, Pose.planar(-1.0, 0.4, 0.6), Pose.planar(0.5, -1.0, 2.5), Pose.planar(30.0, 0.0, 0.0)):
        depth_and_ids, frame = renderer.render_depth_and_ids(pose), renderer.render(pose)
        again = renderer.render_depth_and_ids(pose)
        for found in (depth_and_ids, again):
            np.testing.assert_array_equal(found.depth, frame.depth)
            np.testing.assert_array_equal(found.ids, frame.ids)


@pytest.mark.gl
def test_an_instance_rendered_alone_has_the_same_pixels_as_in_the_whole_frame() -> None:
    rng = np.random.default_rng(3)
    with open_renderer("gl") as renderer:
        assert isinstance(renderer, PartialRenderer)
        renderer.load(furnished_room(), CAMERA)
        for x, y, yaw in rng.uniform((-2.0, -2.0, -3.0), (2.0, 2.0, 3.0), (12, 3)).tolist():
            pose = Pose.planar(x, y, yaw)
            whole = renderer.render_depth_and_ids(pose)
            for number in range(1, 12):
                window, part = renderer.render_instance(pose, number)
                ids, depth = np.zeros_like(whole.ids), np.zeros_like(whole.depth)
                if not window.is_empty:
                    ids[window.top : window.bottom, window.left : window.right] = part.ids
                    depth[window.top : window.bottom, window.left : window.right] = part.depth
                np.testing.assert_array_equal(ids == number, whole.ids == number)
                np.testing.assert_array_equal(depth[ids == number], whole.depth[ids == number])
            np.testing.assert_array_equal(renderer.render(pose).ids, whole.ids)  # the next call renders the whole frame


@pytest.mark.gl
def test_the_count_of_near_pixels_equals_the_count_in_the_whole_frame() -> None:
    rng = np.random.default_rng(4)
    windows = (Window(352, 160, 608, 480), Window(0, 0, 640, 640), Window(300, 600, 340, 640))
    counts = []
    with open_renderer("gl") as renderer:
        assert isinstance(renderer, PartialRenderer)
        renderer.load(furnished_room(), CAMERA)
        for x, y, yaw in rng.uniform((-2.0, -2.0, -3.0), (2.0, 2.0, 3.0), (40, 3)).tolist():
            pose = Pose.planar(x, y, yaw)
            whole = renderer.render_depth_and_ids(pose)
            for window, depth_m in itertools.product(windows, (0.25, 0.6, 2.0)):
                depth = whole.cut(window).depth
                counts.append(renderer.count_within(pose, window, depth_m))
                assert counts[-1] == np.count_nonzero((depth > 0) & (depth < depth_m))
    assert 0 in counts
    assert max(counts) > 1000


@pytest.mark.gl
def test_measurements_in_partial_frames_equal_those_in_the_whole_frame() -> None:
    job = job_for(task=TaskConfig())
    with open_renderer("gl") as renderer:
        renderer.load(furnished_room(), CAMERA)
        for yaw in np.linspace(-3.0, 3.0, 9).tolist():
            for number in (8, 9, 99):  # no part has id 99
                view, frame = (
                    Observation(
                        renderer=lambda: renderer,
                        job=job,
                        instance_id=number,
                        pose=Pose.planar(-1.0, 0.3, yaw),
                        distance_m=1.0,
                        bearing_rad=0.0,
                        is_touching=False,
                    )
                    for _ in "12"
                )
                assert frame.frame is not None
                assert view.obstacle_near == frame.obstacle_near
                assert view.target_mask[:2] == frame.target_mask[:2]
                assert view.target_mask.measure_depth() == frame.target_mask.measure_depth()


def test_a_depth_and_id_frame_requires_a_scene(new_renderer: Renderer) -> None:
    with pytest.raises(UsageError, match="load"):
        new_renderer.render_depth_and_ids(ORIGIN)


def test_frames_are_equal_after_prepared_scenes_were_freed(renderer: Renderer) -> None:
    scene = furnished_room()
    renderer.load(scene, CAMERA)
    first = renderer.render(ORIGIN)
    for _ in range(3):  # more calls than there are prepared scenes
        renderer.make_room()
    renderer.load(scene, CAMERA)
    again = renderer.render(ORIGIN)
    for name in ("rgb", "depth", "ids"):
        assert np.array_equal(getattr(first, name), getattr(again, name))
