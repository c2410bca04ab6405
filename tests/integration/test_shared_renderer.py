"""Rendering processes of a reader: the scenes that they keep loaded, use from several threads, and killed processes."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from structlog.testing import capture_logs

from factory.dataset.packages import ScenePackage
from factory.dataset.rendering import KEPT_SCENES, SharedRenderer, View
from schemas.config import CameraConfig
from schemas.errors import WorldError
from schemas.scene import encode_scene
from schemas.storage.dataset_files import SCENES
from tests.builders.process_state import children_of
from tests.builders.scene import box_room
from workers.geometry.pose import Pose

pytestmark = pytest.mark.gl


@pytest.fixture
def many_scenes(tmp_path: Path) -> list[ScenePackage]:
    """Packages of eight scenes that differ only in their names."""
    (tmp_path / SCENES).mkdir()
    made = []
    for number in range(8):
        scene = box_room()
        info = scene.info.model_copy(update={"name": f"room_{number}"})
        data = encode_scene(dataclasses.replace(scene, info=info))
        sha256 = hashlib.sha256(data).hexdigest()
        (tmp_path / SCENES / f"room_{number}-{sha256[:16]}.scene.zip").write_bytes(data)
        made.append(ScenePackage(tmp_path, f"room_{number}", sha256))
    return made


def render_all(renderer: SharedRenderer, packages: list[ScenePackage]) -> list[np.ndarray]:
    camera, pose = CameraConfig(), Pose.planar(1.0, 1.0, 0.3, 0.0)
    return [renderer.render(View(package, camera, pose, 32), renderer.description).rgb for package in packages]


def test_a_reader_of_many_scenes_keeps_a_few_prepared(many_scenes: list[ScenePackage]) -> None:
    renderer = SharedRenderer("gl")
    first = render_all(renderer, many_scenes)
    assert renderer.prepared_scenes == [tuple(package.sha256 for package in many_scenes[-KEPT_SCENES:])]
    for one, other in zip(first, render_all(renderer, many_scenes), strict=True):
        assert np.array_equal(one, other)
    assert [len(scenes) for scenes in renderer.prepared_scenes] == [KEPT_SCENES]


def test_each_rendering_process_keeps_a_few_scenes_prepared(many_scenes: list[ScenePackage]) -> None:
    renderer = SharedRenderer("gl")
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: render_all(renderer, many_scenes), range(8)))
    assert all(np.array_equal(one, other) for frames in found for one, other in zip(frames, found[0], strict=True))
    assert 1 <= len(renderer.prepared_scenes) <= len(os.sched_getaffinity(0))
    assert all(len(scenes) == KEPT_SCENES for scenes in renderer.prepared_scenes)


def test_a_rendering_process_that_died_is_replaced_at_the_next_frame(many_scenes: list[ScenePackage]) -> None:
    renderer, before = SharedRenderer("gl"), children_of(os.getpid())
    (frame,) = render_all(renderer, many_scenes[:1])
    (pid,) = children_of(os.getpid()) - before
    os.kill(pid, signal.SIGKILL)
    with pytest.raises(WorldError, match="the rendering process died"):
        render_all(renderer, many_scenes[:1])
    assert np.array_equal(render_all(renderer, many_scenes[:1])[0], frame)


@pytest.mark.parametrize(
    ("number", "is_compared", "warnings"), [(None, False, 1), (0, False, 1), (1, False, 0), (None, True, 0)]
)
def test_the_warning_about_another_renderer_is_logged_once_per_loader_and_never_in_a_comparison(
    many_scenes: list[ScenePackage],
    monkeypatch: pytest.MonkeyPatch,
    number: int | None,
    is_compared: bool,
    warnings: int,
) -> None:
    worker = None if number is None else SimpleNamespace(id=number)
    monkeypatch.setitem(sys.modules, "torch.utils.data", SimpleNamespace(get_worker_info=lambda: worker))
    renderer, view = SharedRenderer("gl"), View(many_scenes[0], CameraConfig(), Pose.planar(1.0, 1.0, 0.3, 0.0), 32)
    if is_compared:
        renderer.omit_warnings()
    with capture_logs() as logs:
        for _ in range(2):
            renderer.render(view, "another renderer")
    assert [entry["event"] for entry in logs] == ["renderer_differs"] * warnings


def test_one_of_many_scene_packages_with_the_same_name_is_found_by_its_digest(
    many_scenes: list[ScenePackage], tmp_path: Path
) -> None:
    for package in many_scenes:
        (file,) = (tmp_path / SCENES).glob(f"{package.name}-*")
        file.rename(file.with_name(f"room-{package.sha256[:16]}.scene.zip"))
    for package in many_scenes:
        assert hashlib.sha256(package._replace(name="room").read()).hexdigest() == package.sha256
