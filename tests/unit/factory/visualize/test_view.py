"""The Rerun view of an episode: parts that need no viewer, and the whole view if rerun-sdk is installed."""

from __future__ import annotations

import importlib.util
import io
import re

import numpy as np
import pytest

from factory.dataset.reader import Dataset
from factory.visualize.panels import show_ids
from factory.visualize.rerun import floor_picture, view_episode
from schemas.errors import UsageError
from schemas.scene import decode_scene
from schemas.support.extras import install_command
from tests.builders.dataset import make_dataset, office_package

HAS_RERUN = importlib.util.find_spec("rerun") is not None


@pytest.fixture
def scene():
    return decode_scene(io.BytesIO(office_package()))


def test_the_floor_image_covers_the_grid_and_its_first_row_has_the_smallest_y(scene):
    floor = floor_picture(scene)
    rows, columns = scene.occupancy.shape
    size = scene.info.grid_resolution_m
    span = floor.corners_m.max(axis=0) - floor.corners_m.min(axis=0)
    np.testing.assert_allclose(span[:2], (columns * size, rows * size), rtol=1e-5)
    np.testing.assert_allclose(floor.corners_m[0, :2], scene.info.grid_origin_m, rtol=1e-6)
    assert tuple(floor.uvs[0]) == (0, 0)  # row 0 of the texture (v = 0) is at the smallest y
    assert floor.texture.shape == (rows, columns, 3)
    assert (floor.texture[0, 0] == floor.texture[scene.occupancy == scene.occupancy[0, 0]]).all()


def test_ids_have_distinct_colours_and_the_target_is_red():
    ids = np.arange(200, dtype=np.uint16)
    colours = show_ids(ids, target=7)
    assert tuple(colours[0]) == (0, 0, 0)
    assert tuple(colours[7]) == (255, 40, 40)
    assert len(np.unique(colours, axis=0)) > 190


@pytest.mark.skipif(HAS_RERUN, reason="rerun-sdk is installed")
def test_the_error_of_a_missing_rerun_names_the_extra(scene, tmp_path):
    make_dataset(tmp_path / "dataset", 1)
    with pytest.raises(UsageError, match=re.escape(install_command("view"))):
        view_episode(Dataset(tmp_path / "dataset")[0], scene, tmp_path / "x.rrd")
    assert not (tmp_path / "x.rrd").exists()


@pytest.mark.skipif(not HAS_RERUN, reason="needs rerun-sdk, which the lock does not have")
def test_a_recording_is_written_and_frames_are_counted(scene, tmp_path):
    make_dataset(tmp_path / "dataset", 1)
    told: list[int] = []
    view_episode(Dataset(tmp_path / "dataset")[0], scene, tmp_path / "x.rrd", 5, told.append)
    assert told == [0, 5, 10]
    assert (tmp_path / "x.rrd").stat().st_size > 10_000
