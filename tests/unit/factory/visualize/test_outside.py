"""Films from outside: the robot is in the scene, hides what is behind it, and has a shadow."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import minivla
from factory.dataset.bundle import EpisodeBundle
from factory.visualize.outside import OutsideView, box, cylinder, draw_outside_film, robot_solids, solid_scene
from schemas.config import CameraConfig, RobotConfig
from schemas.scene import CompiledScene, read_geometry
from workers.render import Renderer
from workers.render.choose import open_renderer

FOLDER = Path(minivla.__file__).with_name("sample_data")
pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def renderer() -> Iterator[Renderer]:
    with open_renderer("gl") as opened:
        yield opened


@pytest.fixture(scope="module")
def episode() -> Iterator[EpisodeBundle]:
    with (FOLDER / "episodes/ep_000002.zip").open("rb") as file, EpisodeBundle(file, FOLDER) as bundle:
        yield bundle


@pytest.fixture(scope="module")
def scene() -> CompiledScene:
    return read_geometry(next((FOLDER / "scenes").glob("office-*.zip")))


def test_solids_are_closed_and_face_outwards() -> None:
    for solid in (box((0, 0, 0), (1, 2, 3), (1, 1, 1)), cylinder((0, 0, 0), 1.0, 2.0, 2, (1, 1, 1), sides=400)):
        a, b, c = solid.corners.transpose(1, 0, 2)
        volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6  # positive if all triangles face outwards
        assert volume == pytest.approx(6.0 if len(solid.corners) == 12 else 2 * np.pi, rel=1e-3)


def test_the_robot_stands_on_the_floor_with_the_height_of_its_body() -> None:
    robot = solid_scene(robot_solids(RobotConfig(), CameraConfig()))
    assert robot.positions[:, 2].min() == pytest.approx(0.0, abs=1e-3)
    assert 0.55 < robot.positions[:, 2].max() < 0.75


def test_the_robot_is_in_the_middle_of_the_picture(
    episode: EpisodeBundle, scene: CompiledScene, renderer: Renderer
) -> None:
    picture = OutsideView(episode, scene, renderer).draw(0)
    green = (picture[..., 1].astype(int) - picture[..., 2] > 60) & (picture[..., 1] > picture[..., 0])
    rows, columns = np.nonzero(green)
    assert picture.shape == (320, 480, 3)
    assert len(rows) > 50  # the stripe of the body
    assert 120 < columns.mean() < 360
    assert rows.mean() > 150


def test_a_film_shows_every_stride_and_the_last_frame(
    episode: EpisodeBundle, scene: CompiledScene, renderer: Renderer
) -> None:
    pictures = list(draw_outside_film(episode, scene, renderer, 100, "Go to the table."))
    assert len(pictures) == -(-(episode.length - 1) // 100) + 1
    assert {picture.shape for picture in pictures} == {(360, 800, 3)}
