"""The tables of a dataset: groups, comparison with the paper, and damaged data."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from coordinator.archive.opening import open_archive
from coordinator.expansion.builtin import BUILTIN_PLANS
from coordinator.expansion.plan_file import shrink
from coordinator.tables.write import write_tables
from factory.cli.stats import command
from factory.stats import Statistics, compute_statistics, measure_dataset
from factory.stats.text import print_statistics
from schemas.config import TaskConfig
from schemas.dataset.rows import FailedAttempt
from schemas.errors import ArchiveCorrupt, WorldError
from schemas.instruction.templates import TEMPLATES
from schemas.plan import ScenePlan
from schemas.terms import ExpertName, Split, SuccessMeasure, Tier
from tests.builders.dataset import NOW, failure, make_dataset
from tests.builders.plan import small_plan
from tests.builders.statistics import episode_row, rows_of, two_scenes


def measure(*args: Any, **more: Any) -> Statistics:
    return compute_statistics("data", rows_of(*args, **more), compare_paper=True)


def failed(reason: str, attempt: int = 1, **changes: Any) -> FailedAttempt:
    return failure(1, attempt).model_copy(update={"reason": reason, **changes})


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A dataset that the test may damage: three episodes, one failed attempt."""
    make_dataset(tmp_path / "data", 3)
    return tmp_path / "data"


def row_of(rows: Any, group: str) -> Any:
    (found,) = [row for row in rows if row.group == group]
    return found


def test_rollouts_are_grouped_by_scene_split_and_tier() -> None:
    found = measure(
        [
            episode_row(1, num_steps=100, trajectory_length_m=1.0, final_ne_m=0.96),
            episode_row(2, num_steps=200, trajectory_length_m=2.0, final_ne_m=0.98),
            episode_row(3, num_steps=600, trajectory_length_m=6.0, final_ne_m=0.97, scene="hospital"),
        ]
    )
    office, everything = row_of(found.scenes, "office"), row_of(found.scenes, "all")
    assert (office.n, office.steps_mean, office.tl_mean_m, office.ne_mean_m) == (2, 150, 1.5, pytest.approx(0.97))
    assert (everything.n, everything.steps_mean, everything.steps_median) == (3, 300, 200)
    assert (everything.tl_mean_m, everything.tl_median_m) == (3.0, 2.0)
    assert row_of(found.splits, "train_id").n == row_of(found.tiers, "near").n == 3
    assert row_of(found.splits, "test_id").ne_mean_m is None
    assert row_of(found.scene_tiers, "hospital / near").n == 1


def test_the_papers_values_are_printed_beside_the_measured_ones() -> None:
    found = measure([episode_row()])
    near = row_of(found.tiers, "near")
    assert (near.paper.steps_mean, near.share, near.paper.share) == (128.5, 1.0, 0.545)
    assert row_of(found.splits, "test_id").paper.n == 121
    assert row_of(found.scenes, "all").paper.steps_median == 177


def test_categories_are_listed_in_order_of_decreasing_frequency() -> None:
    found = measure([episode_row(1), episode_row(2), episode_row(3, target_category="sofa")])
    assert [(row.group, row.n) for row in found.categories[:2]] == [("chair", 2), ("sofa", 1)]
    assert row_of(found.categories, "whiteboard").kind == "held out"
    assert row_of(found.categories, "monitor").paper.n == 339
    assert found.three_largest_share == 1.0


def test_every_template_has_a_row_and_the_published_count_of_colour_templates_is_zero() -> None:
    found = measure([episode_row(1, template_id="train_06")])
    assert [row.group for row in found.templates] == list(TEMPLATES)
    row = row_of(found.templates, "train_06")
    assert (row.n, row.kind, row.paper.n) == (1, "train, colour", 0)


def test_only_attempts_with_a_simulated_outcome_count() -> None:
    failures = [failed("collision"), failed("timeout", 2), failed("crash", 3), failed("expired", 3)]
    found = measure([episode_row(1, attempt=3), episode_row(2)], failures)
    office = row_of(found.attempts, "office")
    assert (office.attempts, office.success.count, office.success.share) == (4, 2, 0.5)
    assert (office.collision.share, office.timeout.share) == (0.25, 0.25)
    assert office.reasons == {"collision": 1, "crash": 1, "expired": 1, "timeout": 1}
    assert (office.first.count, office.first.of) == (1, 2)
    assert office.paper.rate == (0.8, 0.9)


def test_attempts_are_grouped_by_tier_and_by_scene_and_tier() -> None:
    failures = [failed("spawn", spawn_tier=Tier.FAR), failed("no_path", scene="hospital", spawn_tier=Tier.FAR)]
    found = measure([episode_row(1)], failures)
    assert row_of(found.attempts, "far").attempts == 2
    assert row_of(found.attempts, "hospital / far").reasons == {"no_path": 1}
    assert row_of(found.attempts, "office / near").success.share == 1.0
    assert row_of(found.attempts, "all").attempts == 3


def test_cells_show_quota_episodes_and_attempts() -> None:
    found = measure([episode_row(1)], [failed("collision")], two_scenes(10))
    (cell,) = [row for row in found.cells if (row.scene, row.split, row.tier) == ("office", "train_id", "near")]
    assert (cell.archived, cell.attempts) == (1, 2)
    assert sum(row.planned for row in found.cells) == 20


def test_navigation_errors_have_quantiles_and_a_share_within_the_radius() -> None:
    episodes = [episode_row(n, final_ne_m=value) for n, value in enumerate((0.9, 1.0, 1.1), 1)]
    row = row_of(measure(episodes).navigation_error, "all")
    assert (row.quantiles["p00"], row.quantiles["p50"], row.quantiles["p100"]) == (0.9, 1.0, 1.1)
    assert (row.within_radius.count, row.within_radius.of) == (2, 3)
    assert row.std == pytest.approx(0.1)


def test_correlation_is_reported_for_all_scenes_and_tiers() -> None:
    episodes = [episode_row(n, spawn_dist_m=2.0 + n, trajectory_length_m=1.0 + n) for n in range(1, 5)]
    found = measure(episodes)
    assert [fit.group for fit in found.correlation] == ["all", "office", "hospital", "near", "mid", "far"]
    assert row_of(found.correlation, "all").slope == pytest.approx(1.0)
    assert "has 0" in row_of(found.correlation, "hospital").remark


def test_far_starts_are_measured_along_the_floor_to_the_centroid_of_the_target() -> None:
    far = {"spawn_tier": Tier.FAR}
    episodes = [
        episode_row(1, spawn_dist_m=3.0, geodesic_m=2.0, **far),  # a free line of 2 m to the circle
        episode_row(2, spawn_dist_m=4.0, geodesic_m=3.5, **far),  # around a corner, 4.5 m
        episode_row(3, spawn_dist_m=4.0, geodesic_m=5.5, **far),  # around a corner, 6.5 m
        episode_row(4, spawn_dist_m=9.0, geodesic_m=8.0, scene="hospital", **far),
        episode_row(5, spawn_dist_m=9.0, geodesic_m=None, scene="hospital", **far),
        episode_row(6, spawn_dist_m=2.0, geodesic_m=1.0),
    ]
    office, hospital, everything = measure(episodes).far
    assert (office.n, office.mean_m) == (3, pytest.approx((3 + 4.5 + 6.5) / 3))
    assert ((office.short.count, office.short.of), office.corner.count) == ((2, 3), 2)
    assert (hospital.n, hospital.mean_m, hospital.interval_m, hospital.corner.count) == (1, 9.0, None, 0)
    assert (everything.n, everything.short.count, everything.corner.share) == (4, 2, 0.5)


def test_far_starts_below_the_distance_of_the_plan_are_counted_as_short(capsys: pytest.CaptureFixture[str]) -> None:
    spawn = two_scenes().spawn.model_copy(update={"far_floor_m": (4.0, 6.0)})
    far = [episode_row(n, spawn_tier=Tier.FAR, geodesic_m=length) for n, length in enumerate((2.5, 3.5, 4.5), 1)]
    found = measure(far, plan=two_scenes().model_copy(update={"spawn": spawn}))
    assert (found.far[0].least_m, found.far[0].short.count, found.far[0].short.of) == (4.0, 1, 3)
    print_statistics(found)
    assert "below 4 m" in capsys.readouterr().out


def test_the_path_of_a_far_start_has_a_corner_if_it_is_longer_than_the_straight_line() -> None:
    by_surface = two_scenes().model_copy(update={"task": TaskConfig(success=SuccessMeasure.SURFACE)})
    row = episode_row(spawn_tier=Tier.FAR, spawn_dist_m=6.0, spawn_surface_m=5.0, final_surface_m=0.9, geodesic_m=4.0)
    (found, *_) = measure([row], plan=by_surface).far
    assert (found.n, found.mean_m, found.corner.count) == (1, 5.0, 0)
    longer = row.model_copy(update={"geodesic_m": 4.5})
    (found, *_) = measure([longer], plan=by_surface).far
    assert (found.mean_m, found.short.count, found.corner.count) == (5.5, 0, 1)


def test_means_of_at_least_two_episodes_have_a_t_interval() -> None:
    found = measure([episode_row(n, num_steps=steps) for n, steps in enumerate((100, 200, 300), 1)])
    half = 4.302653 * 100 / 3**0.5
    assert row_of(found.tiers, "near").steps_interval == pytest.approx((200 - half, 200 + half))
    assert row_of(found.tiers, "mid").steps_interval is None
    assert row_of(measure([episode_row(1)]).tiers, "near").tl_interval_m is None


def test_overlap_counts_instances_that_occur_in_training() -> None:
    test = {"split": Split.TEST_ID}
    found = measure(
        [
            episode_row(1, target_id="chair_001"),
            episode_row(2, target_id="chair_001", **test),
            episode_row(3, target_id="chair_001", **test),
            episode_row(4, target_id="chair_002", **test),
            episode_row(5, target_id="chair_001", scene="hospital", **test),
        ]
    )
    (office,) = [row for row in found.overlap if (row.scene, row.split) == ("office", "test_id")]
    assert (office.targets, office.shared, office.share) == (2, 1, 0.5)
    assert (office.episodes, office.episodes_on_shared) == (3, 2)
    (everything,) = [row for row in found.overlap if (row.scene, row.split) == ("all", "test_id")]
    assert (everything.targets, everything.shared) == (3, 1)  # the chair of the hospital is another instance


def test_an_empty_dataset_has_every_table_and_no_mean() -> None:
    found = measure([], [])
    assert row_of(found.scenes, "all").n == 0
    assert row_of(found.scenes, "all").tl_mean_m is None
    assert found.three_largest_share is None
    assert row_of(found.attempts, "all").success.share is None


def test_no_episode_of_a_valid_dataset_is_omitted(own: Path) -> None:
    found = measure_dataset(own)
    assert found.remarks == ()
    assert (found.episodes, found.planned, found.complete) == (3, 3, True)
    assert row_of(found.attempts or (), "office").reasons == {"timeout": 1}


def test_statistics_of_a_partial_dataset_report_its_completeness(tmp_path: Path) -> None:
    make_dataset(tmp_path / "data", 2, planned=5)
    found = measure_dataset(tmp_path / "data")
    assert found.is_sound
    assert [remark.text for remark in found.remarks] == ["the run is not finished: 2 of 5 planned episodes"]


def test_an_empty_dataset_is_reported(tmp_path: Path) -> None:
    with open_archive(tmp_path / "data") as archive:
        write_tables(archive, small_plan(3), {}, [], [], NOW)
    found = measure_dataset(tmp_path / "data")
    assert found.is_sound
    assert found.remarks[-1].text == "no episodes, so no means can be computed"


def test_missing_episodes_are_omitted_and_named(own: Path) -> None:
    (own / "episodes" / "ep_000002.zip").unlink()
    found = measure_dataset(own)
    assert (found.episodes, found.is_sound) == (2, False)
    assert "1 episodes skipped, because the file is missing: ep_000002" in found.remarks[0].text


def test_truncated_episodes_are_omitted_and_named(own: Path) -> None:
    path = own / "episodes" / "ep_000003.zip"
    size = path.stat().st_size
    path.write_bytes(path.read_bytes()[:1000])
    found = measure_dataset(own)
    assert (found.episodes, found.is_sound) == (2, False)
    assert f"because the file size is wrong: ep_000003 (1000 bytes instead of {size})" in found.remarks[0].text


def test_cells_that_differ_from_the_plan_are_named(own: Path) -> None:
    (own / "episodes" / "ep_000002.zip").unlink()
    texts = [remark.text for remark in measure_dataset(own).remarks]
    assert "1 cells differ from the plan: office / train_id / near has 2 of 3 episodes" in texts


def describe(root: Path, **changes: object) -> None:
    path = root / "dataset_meta.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def resplit(root: Path, splits: list[str]) -> None:
    table = pq.read_table(root / "metadata.parquet")
    rows = [row | {"split": split} for row, split in zip(table.to_pylist(), splits, strict=True)]
    pq.write_table(type(table).from_pylist(rows, schema=table.schema), root / "metadata.parquet")


def test_an_instance_that_is_shared_despite_the_separation_option_is_damage(own: Path) -> None:
    resplit(own, ["train_id", "test_id", "test_id"])
    describe(own, shared_instances={"office": []})
    found = measure_dataset(own)
    assert not found.is_sound
    text = found.remarks[-1].text
    assert "1 instances are in training and evaluation, contrary to the plan: office chair_001" in text


def test_an_instance_that_must_be_shared_is_reported_in_a_note(own: Path) -> None:
    describe(own, shared_instances={"office": ["chair"]})
    found = measure_dataset(own)
    assert found.is_sound
    assert [remark.text for remark in found.remarks] == [
        "office has too few instances of chair to separate training from evaluation"
    ]


def test_wrong_rows_are_omitted_and_named(own: Path) -> None:
    table = pq.read_table(own / "metadata.parquet")
    values = table.to_pylist()
    values[1] |= {"final_ne_m": float("nan"), "spawn_tier": "moon"}
    pq.write_table(type(table).from_pylist(values, schema=table.schema), own / "metadata.parquet")
    found = measure_dataset(own)
    assert found.episodes == 2
    assert "row 2 (ep_000002) has wrong values in final_ne_m, spawn_tier" in found.remarks[0].text


def test_duplicate_rows_are_omitted(own: Path) -> None:
    table = pq.read_table(own / "metadata.parquet")
    pq.write_table(type(table).from_pylist([*table.to_pylist()] * 2, schema=table.schema), own / "metadata.parquet")
    found = measure_dataset(own)
    assert (found.episodes, found.is_sound) == (3, False)


@pytest.mark.parametrize("damage", ["gone", "rubbish"])
def test_statistics_without_an_attempt_log_report_the_rest(own: Path, damage: str) -> None:
    path = own / "attempts.parquet"
    path.unlink() if damage == "gone" else path.write_bytes(b"rubbish")
    found = measure_dataset(own)
    assert found.attempts is None
    assert (found.episodes, found.is_sound) == (3, False)
    assert "attempts are not counted" in found.remarks[0].text
    assert all(cell.attempts is None for cell in found.cells)


def test_a_destroyed_table_of_episodes_is_refused_with_the_remedy(own: Path) -> None:
    (own / "metadata.parquet").write_bytes(b"rubbish")
    with pytest.raises(ArchiveCorrupt, match="resume the run to rewrite it"):
        measure_dataset(own)


def test_a_directory_without_a_dataset_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="is not a dataset"):
        measure_dataset(tmp_path)


def test_command_prints_every_table_beside_the_paper(own: Path) -> None:
    done = CliRunner().invoke(command, [str(own), "--compare-paper"], standalone_mode=False)
    assert (done.exception, done.return_value) == (None, 0)
    for words in ("paper steps", "also in train_id", "first attempts", "slope m/m", "train_18", "80-90 %"):
        assert words in done.stdout


@pytest.mark.parametrize("options", [[], ["--no-compare-paper"]])
def test_command_prints_the_tables_of_another_plan_without_the_paper(own: Path, options: list[str]) -> None:
    done = CliRunner().invoke(command, [str(own), *options], standalone_mode=False)
    assert (done.exception, done.return_value) == (None, 0)
    for words in ("also in train_id", "first attempts", "slope m/m", "train_18", "three largest categories"):
        assert words in done.stdout
    assert "paper" not in done.stdout


def test_only_the_paper_plan_and_its_parts_are_compared_by_default() -> None:
    paper = BUILTIN_PLANS["paper"]
    parts = [
        paper,
        shrink(paper, episodes=60),
        shrink(paper, scenes=("office",), episodes=2),
        shrink(paper, expert=ExpertName.PLANNER, seed=3),
    ]
    lab = ScenePlan(name="lab", usd="lab.usda", seen=("chair",), held_out=("plant",), episodes=3)
    others = [
        BUILTIN_PLANS["demo"],
        BUILTIN_PLANS["balanced"],
        two_scenes(),
        paper.model_copy(update={"scenes": (*paper.scenes, lab)}),
        paper.model_copy(update={"scenes": (paper.scenes[0].model_copy(update={"seed": 4}),)}),
        paper.model_copy(update={"tiers": {Tier.NEAR: 1.0}}),
        paper.model_copy(update={"splits": {Split.TRAIN_ID: 1.0}}),
        paper.model_copy(update={"name": "mine"}),
    ]
    for plan in (*parts, *others):
        rows = rows_of([episode_row(1)], [failed("collision")], plan)
        found = compute_statistics("data", rows)
        published = [row.paper for row in (*found.scenes, *found.tiers, *found.templates, *(found.attempts or ()))]
        assert found.beside_paper is (plan in parts), plan.name
        assert any(published) is found.beside_paper
        assert compute_statistics("data", rows, compare_paper=False).beside_paper is False
        assert compute_statistics("data", rows, compare_paper=True).beside_paper is True


def test_the_command_prints_valid_json(own: Path) -> None:
    done = CliRunner().invoke(command, [str(own), "--json"], standalone_mode=False)
    found = Statistics.model_validate(json.loads(done.stdout))
    assert found == measure_dataset(own)


def test_the_command_exits_with_1_on_damage_and_names_the_omitted_rows(own: Path) -> None:
    (own / "episodes" / "ep_000003.zip").unlink()
    done = CliRunner().invoke(command, [str(own)], standalone_mode=False)
    assert done.return_value == 1
    assert "damage: episodes: 1 episodes skipped" in done.stderr


def test_both_navigation_errors_are_reported_and_start_distances_use_the_measure_of_the_plan() -> None:
    by_surface = two_scenes().model_copy(update={"task": TaskConfig(success=SuccessMeasure.SURFACE)})
    rows = [
        episode_row(n, final_ne_m=1.6, final_surface_m=0.9 + n / 100, spawn_surface_m=n, trajectory_length_m=0.5 * n)
        for n in range(1, 5)
    ]
    found = measure(rows, plan=by_surface)
    assert row_of(found.navigation_error, "all").mean == pytest.approx(0.925)
    assert row_of(found.navigation_error, "all").within_radius.share == 1.0
    assert row_of(found.other_error, "all").mean == pytest.approx(1.6)
    assert found.correlation[0].n == 4
    assert found.correlation[0].slope == pytest.approx(0.5)
    paper = measure(rows)
    assert row_of(paper.navigation_error, "all").mean == pytest.approx(1.6)
    assert row_of(paper.other_error, "all").mean == pytest.approx(0.925)
    assert measure([episode_row()]).other_error == ()
