"""Appearance of rendered episodes: reading, `factory render`, plans, evaluation and Gymnasium give the same factors."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from coordinator.expansion.plan_file import load_plan
from factory.cli.main import cli
from factory.dataset.reader import Dataset
from factory.verify.dataset import verify
from schemas.appearance import Appearance, ClutterRanges, MaterialRanges
from schemas.appearance.appearance_file import load_appearance
from schemas.config import CameraConfig
from schemas.errors import InvalidPlan, UsageError
from schemas.terms import Recording
from tests.builders.lit import lit_room, room_light
from workers.appearance import AppearanceScene, apply_appearance, draw_appearance
from workers.geometry.pose import Pose
from workers.render.choose import open_renderer

pytestmark = pytest.mark.gl
Recordings = dict[Recording, Path]


@pytest.fixture(autouse=True)
def own_cache(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINIVLA_CACHE", str(cache))


def test_light_and_materials_change_colours_but_neither_depth_nor_ids() -> None:
    room = lit_room()
    place, target = AppearanceScene(room, room_light()), room.info.targets[0]
    poses = np.array(((-1.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),))
    ranges = Appearance(light=load_appearance("light").light, materials=MaterialRanges())
    drawn = draw_appearance(ranges, 1, 1, place, target, poses)
    with open_renderer("gl", 160) as renderer:
        for yaw in (0.0, 1.5, 3.0, 4.5):
            pose = Pose.planar(-1.5, 0.0, yaw)
            renderer.load(room, CameraConfig())
            before = renderer.render(pose)
            renderer.load(apply_appearance(room, place.light, drawn), CameraConfig())
            after = renderer.render(pose)
            assert np.array_equal(before.depth, after.depth)
            assert np.array_equal(before.ids, after.ids)
            assert np.abs(before.rgb.astype(int) - after.rgb).mean() > 5
            assert 20 < after.rgb.mean() < 235


def test_clutter_is_visible_in_colour_depth_and_ids_and_hides_nothing_of_the_target() -> None:
    room = lit_room()
    target = room.info.targets[0]
    poses = np.array(((1.0, 0.4, 0.0, 1.0, 0.0, 0.0, 0.0),) * 2)
    ranges = Appearance(clutter=ClutterRanges(count=(30, 30), size_m=(0.3, 0.4), clearance_m=0.0))
    drawn = draw_appearance(ranges, 1, 1, AppearanceScene(room), target, poses)
    changed = apply_appearance(room, None, drawn)
    things = {item.id for item in changed.info.instances[len(room.info.instances) :]}
    seen = set()
    with open_renderer("gl", 160) as renderer:
        renderer.load(room, CameraConfig())
        views = [Pose.planar(1.0, 0.4, yaw) for yaw in (0.0, 1.6, 3.2, 4.8)]
        before = [renderer.render(pose) for pose in views]
        renderer.load(changed, CameraConfig())
        for pose, clean in zip(views, before, strict=True):
            cluttered = renderer.render(pose)
            seen |= set(np.unique(cluttered.ids).tolist()) & things
            own = np.isin(cluttered.ids, sorted(things))
            assert (cluttered.depth[own] < clean.depth[own]).all()
            assert np.array_equal(cluttered.ids == target.instance_id, clean.ids == target.instance_id)
    assert len(seen) > 3


def render(states: Path, out: Path, workers: int) -> Dataset:
    arguments = ["render", str(states), "--appearance", "full", "-o", str(out)]
    options = ["--workers", str(workers), "--renderer", "gl", "--json"]
    assert cli.main([*arguments, *options], standalone_mode=False) == 0
    return Dataset(out)


def test_stored_frames_equal_those_rendered_on_read_for_any_number_of_workers(
    recordings: Recordings, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    stored = [render(recordings[Recording.STATES], tmp_path / str(count), count) for count in (1, 2)]
    assert stored[0].meta.dataset_digest == stored[1].meta.dataset_digest
    clean, read = (Dataset(recordings[Recording.STATES], appearance=name) for name in ("none", "full"))
    for ours, theirs, plain in zip(stored[0], read, clean, strict=True):
        assert ours.appearance == theirs.appearance
        assert ours.appearance is not None
        assert ours.appearance.camera is not None
        assert ours.instances == theirs.instances
        assert ours.states_digest == plain.states_digest
        for t in (0, len(ours) - 1):
            for mine, other in zip(ours.frame(t), theirs.frame(t), strict=True):
                assert mine.tobytes() == other.tobytes()
        assert plain.appearance is None
        assert not np.array_equal(ours.rgb(0), plain.rgb(0))
    report = verify(tmp_path / "1", deep=True)
    assert (report.ok, report.complete) == (True, True)
    capfd.readouterr()


def test_frames_do_not_depend_on_the_order_in_which_they_are_read(recordings: Recordings) -> None:
    def digests(steps: tuple[int, ...]) -> dict[tuple[str, int], str]:
        data = Dataset(recordings[Recording.STATES], appearance="materials")
        episodes = [*data][:: 1 if steps[0] == 0 else -1]
        return {
            (episode.episode_id, t): hashlib.sha256(episode.rgb(t).tobytes()).hexdigest()
            for t in steps
            for episode in episodes
        }

    assert digests((0, 5)) == digests((5, 0))


def test_sensors_of_a_rig_see_the_appearance(recordings: Recordings) -> None:
    states = recordings[Recording.STATES]
    clean, shown = (Dataset(states, rig="paper", appearance=name)[0] for name in ("none", "full"))
    image = shown.observe(0)["front"]
    assert image.rgb is not None
    assert image.rgb.tobytes() == shown.rgb(0).tobytes()
    assert image.rgb.tobytes() != clean.rgb(0).tobytes()


def test_another_appearance_of_stored_frames_is_refused(recordings: Recordings) -> None:
    with pytest.raises(UsageError, match=r"stores frames, whose appearance is fixed: give a dataset of .*states"):
        Dataset(recordings[Recording.FRAMES], appearance="varied")


def test_a_plan_names_an_appearance_or_contains_its_ranges(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    head = '[[scenes]]\nname = "office"\nepisodes = 10\n'
    path.write_text(head)
    plain = load_plan(str(path))
    path.write_text(f'appearance = "varied"\n{head}')
    named = load_plan(str(path))
    assert named.appearance == load_appearance("varied")
    assert plain.appearance is None
    assert "appearance" not in plain.model_dump(mode="json")
    assert named.digest != plain.digest
    path.write_text(f"{head}[appearance.light]\nsky = [0.5, 0.7]\n")
    own = load_plan(str(path))
    assert own.appearance is not None
    assert own.appearance.light is not None
    assert own.appearance.light.sky == (0.5, 0.7)
    path.write_text(f"{head}[appearance.light]\nsky = [0.7, 0.5]\n")
    with pytest.raises(InvalidPlan, match=r"appearance.light.sky: the first value, 0.7, must not be greater"):
        load_plan(str(path))


def test_an_environment_shows_the_appearance_and_refuses_clutter(recordings: Recordings) -> None:
    from factory.gym.env import MiniVLANavEnv

    states = recordings[Recording.STATES]
    seen = []
    for name in (None, "materials", "varied"):
        env = MiniVLANavEnv(data=states, renderer="gl", appearance=name, size=64)
        try:
            seen.append(env.reset(options={"episode": "ep_000001"})[0]["rgb"])
        finally:
            env.close()
    assert len({image.tobytes() for image in seen}) == 3
    with pytest.raises(UsageError, match="clutter, which is placed away from a recorded path"):
        MiniVLANavEnv(data=states, appearance="full")


def test_a_scene_without_baked_light_gets_a_light_map_of_one_texel_for_the_exposure() -> None:
    room = replace(lit_room(), light_map=np.zeros((0, 0, 3), np.uint8), light_uvs=np.zeros((0, 2), np.float32))
    ranges = Appearance.model_validate({"camera": {"exposure_stops": [-1.0, -1.0]}})
    drawn = draw_appearance(ranges, 1, 1, AppearanceScene(room), room.info.targets[0], np.zeros((1, 7)))
    changed = apply_appearance(room, None, drawn)
    assert changed.light_map.shape == (1, 1, 3)
    assert changed.light_map.max() < 255
    assert len(changed.light_uvs) == len(room.positions)
