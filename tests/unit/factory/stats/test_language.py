"""Language statistics of hand-made episodes, in which each number is known by construction."""

from __future__ import annotations

import io
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.typing import NDArray

from factory.cli.stats import command
from factory.report import render_report
from factory.report.figures import language
from factory.report.gather import gather
from factory.report.make import PAGE_FILE
from factory.stats import LanguageStatistics
from factory.stats.language import EpisodeView, summarise_language
from factory.stats.statistics import LanguageRow, Share
from factory.stats.views import measure_language
from schemas.config import CameraConfig
from schemas.encoding.image_sizes import FRAME_SIZE_PX
from schemas.instruction.start_view import SeenObject, see_objects
from schemas.instruction.templates import instruction
from schemas.language.expression import Family
from schemas.language.language_file import LanguageSpec
from schemas.scene import Instance, decode_scene, encode_scene
from tests.builders.bundle import TARGET_ID, BundleParts
from tests.builders.dataset import make_dataset, office_package
from tests.builders.statistics import episode_row

WALL, CHAIR, PLANT = 2, 8, 9
"""Instance ids: a wall without a category, and a second chair and a plant in addition to the target."""
Area = tuple[slice, slice, float]
LEFT, CENTRE, RIGHT = slice(100, 140), slice(300, 340), slice(500, 540)
ROWS = slice(300, 340)


def image(areas: dict[int, Area]) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
    """Returns depth and ids of a wall at 5 m with objects: id -> rows, columns, depth in metres."""
    ids = np.full((FRAME_SIZE_PX, FRAME_SIZE_PX), WALL, np.uint16)
    depth = np.full(ids.shape, 5.0, np.float32)
    for number, (rows, columns, metres) in areas.items():
        ids[rows, columns], depth[rows, columns] = number, metres
    return depth, ids


def view(
    seen: tuple[SeenObject, ...], fitting: set[int] | None = None, arrives: bool = True, **changes: Any
) -> EpisodeView:
    """Returns a view of an episode whose target has id 7; objects 7 and 8 have the category of the target."""
    ahead = {"spawn_x_m": 0.0, "spawn_y_m": 0.0, "spawn_yaw_rad": 0.0, "goal_x_m": 2.0, "goal_y_m": 0.0}
    row = episode_row(1, **ahead | changes)
    return EpisodeView(row, TARGET_ID, frozenset({7, 8}), frozenset(fitting or {7}), seen, arrives)


def all_of(views: list[EpisodeView]) -> LanguageRow:
    return summarise_language("data", "run", ["office"], len(views), views).rows[-1]


def counted(share: Share) -> tuple[int, int]:
    return share.count, share.of


def test_an_object_is_measured_by_its_nearest_point_and_its_mean_column() -> None:
    depth, ids = image({7: (slice(320, 321), slice(460, 500), 2.0), 8: (slice(0, 1), slice(0, 40), 2.0)})
    depth[320, 470] = 1.0
    target, other = see_objects(ids, depth, {7, 8, 9}, CameraConfig(), 32)
    assert (target.id, other.id) == (7, 8)
    assert target.bearing_rad == pytest.approx(math.atan((480 - 320) / 320))
    assert other.bearing_rad == pytest.approx(math.atan((20 - 320) / 320))
    assert target.range_m == pytest.approx(math.hypot(1, (470.5 - 320) / 320, 0.5 / 320))
    assert other.range_m == pytest.approx(2 * math.hypot(1, (39.5 - 320) / 320, (0.5 - 320) / 320))


def test_an_object_with_too_few_pixels_or_without_a_category_is_not_in_view() -> None:
    depth, ids = image({7: (slice(0, 1), slice(0, 31), 1.0), 8: (slice(2, 3), slice(0, 32), 1.0)})
    assert [seen.id for seen in see_objects(ids, depth, {7, 8}, CameraConfig(), 32)] == [8]
    assert see_objects(ids, depth, set(), CameraConfig(), 32) == ()


def test_baselines_choose_by_distance_by_bearing_and_by_bearing_within_the_category() -> None:
    near, middle = SeenObject(PLANT, 1.0, 0.5, 50), SeenObject(CHAIR, 2.0, -0.1, 50)
    row = all_of(
        [
            view((SeenObject(7, 0.5, 0.0, 50), near, middle)),  # the target is the nearest and the most central object
            view((SeenObject(7, 3.0, 0.2, 50), near, middle)),  # the target is neither
            view((SeenObject(7, 3.0, 0.2, 50), SeenObject(PLANT, 1.0, 0.0, 50))),  # the only object of its category
            view(()),  # nothing in view
        ]
    )
    assert (counted(row.nearest), counted(row.central), counted(row.central_of_category)) == ((1, 4), (1, 4), (2, 4))
    assert (row.nearest.low, row.nearest.high) == (pytest.approx(0.0456, abs=1e-4), pytest.approx(0.6994, abs=1e-4))


def test_the_largest_object_of_the_category_is_found_and_only_possible_targets_count() -> None:
    small, large, near = SeenObject(7, 3.0, 0.0, 50), SeenObject(8, 4.0, 0.1, 90), SeenObject(12, 1.0, 0.2, 900)
    seen = (small, large, near)
    of_category = replace(view(seen), of_category=frozenset({7, 8, 12}))
    drawn = replace(of_category, choices=frozenset({7, 8}))
    plain, row = all_of([of_category]), all_of([drawn])
    assert (plain.chance, row.chance) == (pytest.approx(1 / 3), pytest.approx(1 / 2))
    assert (plain.others_in_view, row.others_in_view) == (2.0, 1.0)
    assert (counted(plain.nearest_of_category), counted(row.nearest_of_category)) == ((0, 1), (1, 1))
    assert counted(row.largest_of_category) == (0, 1)
    larger = replace(drawn, seen=(replace(small, pixels=91), large, near))
    assert counted(all_of([larger]).largest_of_category) == (1, 1)


def test_a_random_choice_cannot_select_a_target_that_is_not_of_the_named_category() -> None:
    target, chair = SeenObject(7, 1.0, 0.0, 50), SeenObject(8, 2.0, 0.1, 50)
    of_another_category = replace(view((target, chair)), of_category=frozenset({8, 12}))
    alone = replace(view((target,)), of_category=frozenset({8, 12}))
    row = all_of([of_another_category, alone, view((target, chair))])
    assert row.chance == pytest.approx((0 + 0 + 1 / 2) / 3)


def test_instructions_that_are_ambiguous_in_the_scene_and_in_view_are_counted() -> None:
    both = (SeenObject(7, 1.0, 0.0, 50), SeenObject(8, 2.0, 0.1, 50))
    row = all_of([view(both, {7}), view(both, {7, 8}), view(both[:1], {7, 8}), view(both[1:], {7, 8, 12})])
    assert (counted(row.several_in_scene), counted(row.several_in_view)) == ((3, 4), (1, 4))


def test_a_start_is_contradictory_if_only_other_objects_of_the_category_are_in_view() -> None:
    target, chair, plant = (SeenObject(number, 1.0, 0.0, 50) for number in (7, 8, 9))
    row = all_of([view((target, chair)), view((chair,)), view((plant,)), view(())])
    assert counted(row.contradictory) == (1, 4)


@pytest.mark.parametrize(("degrees", "is_seen", "wrong"), [(29, True, 0), (31, True, 1), (0, False, 1), (-31, True, 1)])
def test_a_target_in_front_is_in_view_and_within_30_degrees_of_the_heading(
    degrees: float, is_seen: bool, wrong: int
) -> None:
    seen = (SeenObject(7, 1.0, 0.0, 50),) if is_seen else ()
    row = all_of([view(seen, template_id="train_11", spawn_yaw_rad=math.radians(degrees)), view(())])
    assert counted(row.not_in_front) == (wrong, 1)


def test_rows_are_grouped_by_scene_and_arrivals_by_category() -> None:
    views = [view((), arrives=False), view(()), view((), scene="hospital", target_category="sofa", template_id="own")]
    found = summarise_language("data", "run", ["office", "hospital"], 3, views)
    assert [(row.group, row.n) for row in found.rows] == [("office", 2), ("hospital", 1), ("all", 3)]
    assert [(row.group, *counted(row.in_view)) for row in found.arrivals] == [
        ("chair", 1, 2),
        ("sofa", 1, 1),
        ("all", 2, 3),
    ]
    assert found.instructions == 1


def scene_with_two_chairs() -> bytes:
    scene = decode_scene(io.BytesIO(office_package()))
    more = [Instance(id=CHAIR, prim_path="/World/chair_2", category="chair")]
    more += [Instance(id=PLANT, prim_path="/World/plant", category="plant"), Instance(id=WALL, prim_path="/World/wall")]
    info = scene.info.model_copy(update={"instances": (*scene.info.instances, *more)})
    return encode_scene(type(scene)(**vars(scene) | {"info": info}), level=1)


STARTS: list[dict[int, Area]] = [
    {TARGET_ID: (ROWS, CENTRE, 1.0), PLANT: (ROWS, LEFT, 2.0)},
    {TARGET_ID: (ROWS, RIGHT, 3.0), CHAIR: (ROWS, CENTRE, 2.0), PLANT: (ROWS, LEFT, 1.0)},
    {CHAIR: (ROWS, RIGHT, 2.0)},
    {TARGET_ID: (ROWS, RIGHT, 2.0), PLANT: (ROWS, CENTRE, 1.0)},
]


def hand_made(parts: BundleParts) -> BundleParts:
    """Replaces first frames; the third instruction says `in front of you`, the fourth drive ends without its target."""
    number = parts.meta.job.index - 1
    rgb = parts.frames[0][0]
    parts = parts.with_frame(0, (rgb, *image(STARTS[number])))
    if number == 2:
        parts = parts.with_job(template_id="train_11", instruction=instruction("train_11", "chair", "red"))
    if number == 3:
        parts = parts.with_frame(len(parts.frames) - 1, (rgb, *image({})))
    return parts


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four episodes in a scene with two chairs and a plant; the tests only read it."""
    root = tmp_path_factory.mktemp("language") / "data"
    make_dataset(root, 4, package=scene_with_two_chairs(), change=hand_made)
    return root


def test_the_statistics_of_a_dataset_come_from_its_first_and_last_frames(data: Path) -> None:
    told: list[tuple[int, int]] = []
    found = measure_language(data, lambda done, total: told.append((done, total)))
    row = found.rows[-1]
    assert (found.read, found.episodes, found.instructions, found.is_sound) == (4, 4, 2, True)
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert (counted(row.nearest), counted(row.central), counted(row.central_of_category)) == ((1, 4), (1, 4), (2, 4))
    assert (counted(row.several_in_scene), counted(row.several_in_view)) == ((4, 4), (1, 4))
    assert (counted(row.contradictory), counted(row.not_in_front)) == ((1, 4), (1, 1))
    assert [(row.group, *counted(row.in_view)) for row in found.arrivals] == [("chair", 3, 4), ("all", 3, 4)]


def test_the_command_prints_the_tables_in_80_columns_and_the_same_numbers_as_json(data: Path) -> None:
    done = CliRunner().invoke(command, [str(data), "--language"], standalone_mode=False)
    assert (done.exception, done.return_value) == (None, 0)
    lines = done.stdout.splitlines()[1:]  # the first line has the path of the dataset
    assert max(map(len, lines)) <= 80
    assert any(line.split()[:4] == ["all", "4", "25", "%"] for line in lines)
    done = CliRunner().invoke(command, [str(data), "--language", "--json"], standalone_mode=False)
    assert LanguageStatistics.model_validate(json.loads(done.stdout)) == measure_language(data)


def test_a_damaged_episode_and_a_missing_scene_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_dataset(tmp_path / "data", 2)
    path = tmp_path / "data" / "episodes" / "ep_000002.zip"
    path.write_bytes(bytes(path.stat().st_size))
    found = measure_language(tmp_path / "data")
    assert (found.read, found.episodes) == (1, 2)
    assert [(remark.is_damage, remark.file) for remark in found.remarks] == [(True, "episodes/ep_000002.zip")]
    (tmp_path / "data" / "scenes").rename(tmp_path / "elsewhere")
    found = measure_language(tmp_path / "data")
    assert found.read == 0
    assert "the episodes of office are skipped" in found.remarks[0].text
    done = CliRunner().invoke(command, [str(tmp_path / "data"), "--language"], standalone_mode=False)
    assert (done.exception, done.return_value) == (None, 1)
    monkeypatch.setenv("MINIVLA_SCENES", str(tmp_path / "elsewhere"))
    assert measure_language(tmp_path / "data").read == 1


def test_the_report_shows_the_shares_of_the_language_statistics(data: Path) -> None:
    files, _ = render_report(gather(data), draw_functions=(language.draw,))
    page = files[PAGE_FILE].decode().replace("\u00a0", " ")
    assert "Shares of 4 episodes with 95 % Wilson intervals; 2 distinct instructions." in page
    assert ">75 % (30–95)<" in page
    assert "figures/language.svg" in files


def test_shares_of_features_and_patterns_are_counted_beside_the_shares_that_the_plan_asks_for():
    spec = LanguageSpec(
        features={**dict.fromkeys(LanguageSpec().families, 0.0), "near": 3.0, "ordinal": 1.0},
        largest_shares={Family.ORDINAL: 0.4},
    )
    said = [{"near"}, {"near", "ordinal"}, {"ordinal"}, {"near"}, set[str]()]
    seen = (SeenObject(7, 0.5, 0.0, 50),)
    views = [replace(view(seen, template_id=f"en_terse_{len(one)}"), features=frozenset(one)) for one in said]
    found = summarise_language("data", "run", ["office"], 5, views, spec=spec)
    near, ordinal = found.features
    assert (near.feature, near.asked, near.largest, counted(near.realised)) == ("near", 0.75, None, (3, 5))
    assert (ordinal.feature, ordinal.asked, ordinal.largest, counted(ordinal.realised)) == (
        "ordinal",
        0.25,
        0.4,
        (2, 5),
    )
    assert [(row.pattern, row.realised.count) for row in found.patterns] == [
        *(("en_terse_1", 3), ("en_terse_2", 1), ("en_terse_0", 1))
    ]
    relabelled = summarise_language("data", "run", ["office"], 5, views).features
    assert {(row.feature, row.asked) for row in relabelled} == {("near", None), ("ordinal", None)}
    assert summarise_language("data", "run", ["office"], 1, [view(seen)], spec=spec).features == ()
