"""Videos and contact sheets of an episode: content, codecs, and the message for a wrong suffix."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from factory.cli.show import command
from factory.visualize.film import draw_film, facts_of_step, film_rate
from factory.visualize.panels import TrackMap, draw_contact_sheet, show_depth, show_ids
from schemas.bundle import BundleReader
from schemas.errors import UsageError
from schemas.scene import CompiledScene, decode_scene
from tests.builders.dataset import make_dataset, office_package


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film") / "dataset"
    make_dataset(folder, episodes=1)
    return folder


@pytest.fixture
def episode(root: Path) -> Iterator[BundleReader]:
    with (root / "episodes/ep_000001.zip").open("rb") as file, BundleReader(file) as bundle:
        yield bundle


def scene() -> CompiledScene:
    return decode_scene(io.BytesIO(office_package()))


@pytest.mark.parametrize(
    ("hz", "fps", "stride", "rate"), [(60, 30, 2, 30), (60, 15, 4, 15), (20, 30, 1, 20), (50, 30, 2, 25)]
)
def test_videos_run_in_real_time(hz: int, fps: int, stride: int, rate: int) -> None:
    assert film_rate(hz, fps) == (stride, Fraction(rate))


def test_a_video_ends_with_the_last_frame_and_has_even_dimensions(episode: BundleReader) -> None:
    pictures = list(draw_film(episode, scene(), 5))
    assert episode.length == 12
    assert len(pictures) == 4
    assert {picture.shape for picture in pictures} == {(376, 1280, 3)}
    colour = np.asarray(Image.fromarray(episode.rgb(11)).resize((320, 320), Image.Resampling.BOX))
    assert np.array_equal(pictures[-1][:320, :320], colour)


def test_the_map_shows_the_track_so_far(episode: BundleReader) -> None:
    chart = TrackMap(episode, scene(), 2400)
    first, last = (np.asarray(chart.draw(steps)) for steps in (1, episode.length))
    blue = [int((picture == (20, 80, 220)).all(axis=2).sum()) for picture in (first, last)]
    assert blue[0] > 0
    assert not np.array_equal(first, last)


def test_near_depth_is_brighter_than_far_and_no_pixel_is_black() -> None:
    shown = show_depth(np.array([[0.0, 0.3, 2.0, 9.0, 50.0]], np.float32)).sum(axis=2)[0]
    assert shown[0] == 0
    assert list(shown[1:]) == sorted(shown[1:], reverse=True)


def test_an_instance_has_one_colour_and_the_target_is_red() -> None:
    shown = show_ids(np.array([[5, 6, 5, 7, 0]], np.uint16), target=7)[0].tolist()
    assert shown[0] == shown[2] != shown[1]
    assert shown[3:] == [[255, 40, 40], [0, 0, 0]]


def test_mp4_uses_the_most_compatible_codec(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "e.mp4"
    done = CliRunner().invoke(command, [str(root), "1", "-o", str(out), "--json"], catch_exceptions=False)
    assert json.loads(done.stdout)["fps"] == 30
    with av.open(str(out)) as film:
        (stream,) = film.streams.video
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert stream.average_rate == 30
        pictures = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(pictures) == 7 + 30
    assert [path.name for path in out.parent.iterdir()] == ["e.mp4"]


def test_gif_and_contact_sheet_can_be_opened(root: Path, tmp_path: Path) -> None:
    for name in ("e.gif", "e.png"):
        CliRunner().invoke(command, [str(root), "ep_000001", "-o", str(tmp_path / name)], catch_exceptions=False)
    with Image.open(tmp_path / "e.gif") as film:
        assert film.size == (1280, 376)
        assert film.n_frames > 1  # type: ignore[attr-defined]
    with Image.open(tmp_path / "e.png") as sheet:
        assert sheet.size == (9 * 240, 72 + 3 * 240)


@pytest.mark.parametrize("columns", [2, 6, 24])
def test_the_header_of_a_contact_sheet_scales_with_its_width(episode: BundleReader, columns: int) -> None:
    sheet = draw_contact_sheet(episode, scene(), columns)
    head = np.asarray(sheet.convert("L"))[: sheet.height - 3 * 240]
    rows, across = (np.flatnonzero((head < 128).any(axis=axis)) for axis in (1, 0))
    assert np.ptp(rows) > 0.6 * len(head)
    assert across.max() < sheet.width - 4


def test_a_long_header_of_a_contact_sheet_is_scaled_down(root: Path) -> None:
    with (root / "episodes/ep_000001.zip").open("rb") as file, BundleReader(file) as bundle:
        job = bundle.meta.job.model_copy(update={"instruction": "Please go to the chair. " * 20})
        bundle.meta = bundle.meta.model_copy(update={"job": job})
        sheet = draw_contact_sheet(bundle, scene(), 2)
    head = np.asarray(sheet.convert("L"))[: sheet.height - 3 * 240]
    assert np.flatnonzero((head < 128).any(axis=0)).max() < sheet.width - 4


def test_a_video_states_to_which_point_its_distance_is_measured(episode: BundleReader) -> None:
    assert facts_of_step(episode, 11).endswith(" m from the target's centre")


@pytest.mark.parametrize("name", ["e.avi", "e"])
def test_the_error_of_a_wrong_suffix_lists_the_supported_suffixes(root: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match=r"supported suffixes: \.png, \.mp4, \.gif"):
        CliRunner().invoke(command, [str(root), "1", "-o", str(tmp_path / name)], catch_exceptions=False)
    assert list(tmp_path.iterdir()) == []
