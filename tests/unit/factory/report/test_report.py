"""Complete reports of small datasets: content of the page, self-containedness, and damaged data."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from factory.html.palette import colour
from factory.report import make_report, render_report
from factory.report.comparison.rows import compare
from factory.report.figures import action_space, attempts, samples, spawn_maps
from factory.report.figures.registry import DRAW_FUNCTIONS
from factory.report.gather import gather
from factory.report.make import PAGE_FILE
from factory.stats import measure_dataset
from schemas.errors import ArchiveCorrupt, WorldError
from tests.builders.dataset import make_dataset
from tests.builders.html import Outline

HOSTILE = 'Go to the <script>alert("x")</script> & stop.'


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset that the tests only read: three episodes, one failed attempt."""
    root = tmp_path_factory.mktemp("report") / "data"
    make_dataset(root, 3)
    return root


@pytest.fixture(scope="module")
def files(data: Path) -> dict[str, bytes]:
    return render_report(gather(data, compare_paper=True))[0]


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A dataset that the test may damage."""
    make_dataset(tmp_path / "data", 3)
    return tmp_path / "data"


def page_of(root: Path) -> str:
    """Returns the page of a report with only one figure, which is the fastest to draw."""
    return render_report(gather(root), draw_functions=(action_space.draw,))[0][PAGE_FILE].decode()


def change_rows(root: Path, column: str, value: object) -> None:
    path = root / "metadata.parquet"
    table = pq.read_table(path)
    place = table.schema.get_field_index(column)
    values = pa.array([value] * table.num_rows, table.schema.field(column).type)
    pq.write_table(table.set_column(place, table.schema.field(column), values), path)


def test_the_page_is_complete_and_contains_every_figure(files: dict[str, bytes]) -> None:
    outline = Outline(files[PAGE_FILE].decode())
    assert len(set(outline.ids)) == len(outline.ids)
    anchors = [link[1:] for link in outline.links if link.startswith("#")]
    assert set(anchors) <= set(outline.ids)
    assert files[PAGE_FILE].count(b"<section id=") == len(DRAW_FUNCTIONS) + 2
    assert files[PAGE_FILE].count(b'<li><a href="#') == len(DRAW_FUNCTIONS) + 2


def test_the_page_makes_no_network_request_and_runs_no_script(files: dict[str, bytes]) -> None:
    text = files[PAGE_FILE].decode()
    outline = Outline(text)
    assert all(link.startswith(("#", "data:image/")) for link in outline.links)
    assert not outline.tags & {"script", "link", "iframe", "object"}
    assert not re.search(r"url\((?!#)|@import", text)
    assert "default-src 'none'" in text


def test_tables_scroll_in_containers_that_the_keyboard_reaches(files: dict[str, bytes]) -> None:
    parents = Outline(files[PAGE_FILE].decode()).table_parents
    assert len(parents) > len(DRAW_FUNCTIONS)
    for classes, attributes in parents:
        assert "table" in classes.split()
        assert attributes["tabindex"] == "0"
        assert attributes["aria-label"]


def test_every_drawing_is_written_as_svg_and_png(files: dict[str, bytes]) -> None:
    names = {name.rsplit(".", 1)[0] for name in files if name.startswith("figures/")}
    assert len(names) >= 16
    for name in names:
        assert ET.fromstring(files[f"{name}.svg"]).tag.endswith("svg")
        with Image.open(io.BytesIO(files[f"{name}.png"])) as picture:
            assert picture.width == 940
            assert len(set(picture.convert("L").resize((64, 64)).tobytes())) > 2, name


def test_the_same_dataset_gives_the_same_bytes(files: dict[str, bytes], data: Path) -> None:
    again, _ = render_report(gather(data, compare_paper=True))
    assert {name for name in files if files[name] != again.get(name)} == set()
    assert again.keys() == files.keys()


def test_the_page_does_not_contain_the_path_of_the_dataset(files: dict[str, bytes], data: Path) -> None:
    assert not [name for name, content in files.items() if str(data.parent).encode() in content]


def test_numbers_are_those_of_the_statistics(files: dict[str, bytes], data: Path) -> None:
    found = measure_dataset(data)
    text = files[PAGE_FILE].decode()
    assert f"<strong>{found.scenes[-1].tl_mean_m:.2f} m</strong>" in text
    assert f"<strong>{found.scenes[-1].steps_mean:.1f}</strong>" in text
    assert "3 episodes" in text


def test_the_page_shows_interval_target_and_verdict_of_each_comparison(files: dict[str, bytes], data: Path) -> None:
    rows = compare(gather(data, compare_paper=True))
    text = files[PAGE_FILE].decode()
    for verdict in ("inside", "outside", "undecided"):
        assert text.count(f"<td>{verdict}</td>") == sum(row.verdict == verdict for row in rows)
    assert sum(row.verdict is not None for row in rows) > 5
    (success,) = [row for row in rows if row.what == "first near and mid attempts that succeed, office"]
    assert (success.ours, success.target, success.verdict) == (0.75, (0.8, 0.9), "undecided")
    assert ">75.0 %<small>30–95</small></td>" in text.replace("\u00a0", " ")


@pytest.fixture(scope="module")
def alone(data: Path) -> dict[str, bytes]:
    """The default report of the same dataset, whose plan is not the paper's."""
    return render_report(gather(data))[0]


def test_the_page_of_another_plan_does_not_name_the_paper(files: dict[str, bytes], alone: dict[str, bytes]) -> None:
    words = re.compile(r"\bpaper|\bFig\.|\bTable [IVX]+|\bSec\. ", re.IGNORECASE)
    style = re.compile(r"<style>.*?</style>|<svg.*?</svg>", re.DOTALL)
    assert words.search(style.sub("", files[PAGE_FILE].decode()))
    assert [found.group() for found in words.finditer(style.sub("", alone[PAGE_FILE].decode()))] == []
    Outline(alone[PAGE_FILE].decode())


def test_the_drawings_of_another_plan_have_no_mark_of_the_paper(
    files: dict[str, bytes], alone: dict[str, bytes]
) -> None:
    ink = colour("paper").encode()
    marked = {name for name, content in files.items() if name.endswith(".svg") and ink in content}
    assert {"figures/tl_histogram.svg", "figures/ne_cdf.svg", "figures/success_rates.svg"} <= marked
    assert not {name for name, content in alone.items() if name.endswith(".svg") and ink in content}


def test_numbers_of_another_plan_do_not_depend_on_the_comparison_with_the_paper(data: Path) -> None:
    beside, alone = measure_dataset(data, compare_paper=True), measure_dataset(data)
    assert (beside.beside_paper, alone.beside_paper) == (True, False)
    assert '"source"' in beside.model_dump_json()
    assert '"source"' not in alone.model_dump_json()
    assert [row.tl_mean_m for row in alone.scenes] == [row.tl_mean_m for row in beside.scenes]


def test_instructions_are_escaped(own: Path) -> None:
    change_rows(own, "instruction", HOSTILE)
    text = render_report(gather(own), draw_functions=(samples.draw,))[0][PAGE_FILE].decode()
    assert "script" not in Outline(text).tags
    assert "&lt;script&gt;" in text


def test_a_damaged_episode_is_omitted_and_reported(own: Path) -> None:
    path = own / "episodes" / "ep_000002.zip"
    path.write_bytes(bytes(path.stat().st_size))  # the statistics would already exclude a truncated file
    material = gather(own)
    assert sorted(material.drives.tracks) == ["ep_000001", "ep_000003"]
    (remark,) = material.statistics.remarks
    assert (remark.is_damage, remark.file) == (True, "episodes/ep_000002.zip")
    assert "skipped in trajectories" in remark.text
    text = render_report(material, draw_functions=(action_space.draw,))[0][PAGE_FILE].decode()
    assert "Skipped data" in text
    assert "episodes/ep_000002.zip" in text


def test_a_missing_map_is_reported_and_the_rest_is_drawn(own: Path) -> None:
    for package in (own / "scenes").glob("*.scene.zip"):
        package.unlink()
    files, summary = render_report(gather(own), draw_functions=(spawn_maps.draw,))
    assert "figures/spawn_map_office.svg" in files
    assert any("no map of office" in remark.text for remark in summary.remarks)


def test_an_unreadable_attempt_log_is_reported(own: Path) -> None:
    (own / "attempts.parquet").write_bytes(b"nothing")
    files, summary = render_report(gather(own), draw_functions=(attempts.draw,))
    assert "figures/attempts.svg" not in files
    assert [remark.file for remark in summary.remarks] == ["attempts.parquet"]
    assert "the table of attempts cannot be read" in files[PAGE_FILE].decode()


def test_the_page_of_an_empty_dataset_reports_that_it_is_empty(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 0, planned=3)
    files, summary = render_report(gather(tmp_path / "data"))
    text = files[PAGE_FILE].decode()
    Outline(text)
    assert (summary.episodes, summary.planned, summary.comparisons) == (0, 3, ())
    assert "No episodes to show." in text
    assert "0 of 3 planned episodes" in text


def test_the_page_of_a_partial_dataset_reports_its_completeness(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 1, planned=3)
    text = page_of(tmp_path / "data")
    assert "the run is not finished: 1 of 3 planned episodes" in text


def test_a_missing_dataset_or_table_is_an_error(own: Path, tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="is not a dataset"):
        make_report(tmp_path / "nothing", tmp_path / "out")
    (own / "metadata.parquet").unlink()
    with pytest.raises(ArchiveCorrupt, match="missing"):
        make_report(own, tmp_path / "out")
    assert not (tmp_path / "out").exists()
