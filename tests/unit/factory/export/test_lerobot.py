"""LeRobot datasets: equal to those of LeRobot's writer, with the content of the bundles."""

from __future__ import annotations

import io
import json
import shutil
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

from factory.dataset.reader import Dataset
from factory.export.base import ExportPiece, Finish
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.lerobot.columns import frame_columns, outcome_columns
from factory.export.lerobot.features import DepthCode
from factory.export.lerobot.layout import DEPTH, EXTRA_FOLDER, IDS, RGB
from factory.export.lerobot.piece import LeRobotFacts
from factory.export.lerobot.v21 import MODALITY
from factory.export.lerobot.v30 import FileLimits, write_dataset
from factory.export.options import LeRobotOptions
from factory.export.output import Output
from factory.export.registry import find_exporter
from factory.export.video import read_video
from schemas.errors import UsageError
from schemas.tokens import tokens_of
from tests.unit.factory.export.varied import STEPS, episode_parts

FROZEN = json.loads((Path(__file__).parents[3] / "readers/lerobot_schema.json").read_text())
DATA, EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"
ORDER = ("ep_000002", "ep_000004", "ep_000003", "ep_000001")
"""The episodes sorted by split."""
FAR_M = 30.0


def export(root: Path, out: Path, name: str, **options: Any) -> Path:
    chosen = find_exporter(name).options.model_validate(options)
    assert run_export(ExportOrder(root, out, name, chosen)).complete
    return out


@pytest.fixture(scope="module")
def everything(varied: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Version 3.0 with depth and ids, at 60 frames per second."""
    return export(varied, tmp_path_factory.mktemp("lerobot") / "out", "lerobot", depth=True, ids=True)


@pytest.fixture(scope="module")
def slow(varied: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Version 3.0, RGB only, at 20 frames per second."""
    return export(varied, tmp_path_factory.mktemp("lerobot") / "out", "lerobot", fps=20)


@pytest.fixture(scope="module")
def older(varied: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Version 2.1 at 30 frames per second."""
    return export(varied, tmp_path_factory.mktemp("lerobot") / "out", "lerobot-v2.1", fps=30)


def types_of(path: Path) -> dict[str, str]:
    return {field.name: str(field.type) for field in pq.read_schema(path)}


def info_of(root: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((root / "meta/info.json").read_text())
    return found


def column(table: pa.Table, name: str) -> np.ndarray[Any, Any]:
    return np.asarray(table[name].to_pylist())


PARTS = {"main": ".", "extra": EXTRA_FOLDER}
"""Dataset in `FROZEN` -> its folder in an export with depth and ids."""


@pytest.mark.parametrize(("part", "folder"), PARTS.items())
def test_info_equals_that_of_lerobots_writer(everything: Path, part: str, folder: str) -> None:
    ours, theirs = info_of(everything / folder), json.loads(json.dumps(FROZEN[part]["info"]))
    assert ours.keys() == theirs.keys()
    assert ours["features"].pop("origin") == {"dtype": "string", "shape": [1], "names": None}  # ours only
    assert list(ours["features"]) == list(theirs["features"])
    for name, feature in theirs["features"].items():
        mine = ours["features"][name]
        encoder = {"video.crf", "video.extra_options"}  # encoder settings, not needed by readers
        info = {key: value for key, value in feature.pop("info", {}).items() if key not in encoder}
        assert {key: value for key, value in mine.pop("info", {}).items() if key not in encoder} == info
        assert mine == feature
    counted = {"total_episodes", "total_frames", "total_tasks", "splits", "features"}
    assert {k: v for k, v in ours.items() if k not in counted} == {k: v for k, v in theirs.items() if k not in counted}


def test_no_policy_takes_depth_ids_or_world_poses(everything: Path) -> None:
    """A policy takes every image and video, and every column of `observation` or `action` (LeRobot 0.6.1)."""
    features = info_of(everything)["features"]
    taken = {
        name
        for name, feature in features.items()
        if feature["dtype"] in ("image", "video") or name.startswith(("observation", "action"))
    }
    assert taken == {RGB, "observation.state", "action"}
    assert features[RGB]["shape"][2] == 3
    extra = info_of(everything / EXTRA_FOLDER)["features"]
    assert {DEPTH, IDS} <= extra.keys()
    assert not [name for name in extra if name.startswith(("observation", "action"))]


@pytest.mark.parametrize(("part", "folder"), PARTS.items())
def test_tables_equal_those_of_lerobots_writer(everything: Path, part: str, folder: str) -> None:
    root, frozen = everything / folder, FROZEN[part]
    assert types_of(root / DATA) == frozen["data"] | {"origin": "string"}
    described = json.loads(pq.read_schema(root / DATA).metadata[b"huggingface"])
    assert described["info"]["features"].pop("origin") == {"dtype": "string", "_type": "Value"}
    assert described == frozen["data_features"]
    ours = types_of(root / EPISODES)
    assert {name: kind for name, kind in ours.items() if name in frozen["episodes"]} == frozen["episodes"]
    assert list(ours)[: len(frozen["episodes"])] == list(frozen["episodes"])
    assert {"split", "episode_id", "goal_x_m", "geodesic_m"} <= ours.keys()
    assert types_of(root / "meta/tasks.parquet") == frozen["tasks"]
    pandas = json.loads(pq.read_schema(root / "meta/tasks.parquet").metadata[b"pandas"])
    for key in ("index_columns", "columns", "column_indexes"):
        assert pandas[key] == frozen["tasks_pandas"][key]
    stats = json.loads((root / "meta/stats.json").read_text())
    assert {feature: sorted(values) for feature, values in stats.items()} == frozen["stats"]


def test_the_files_are_those_of_lerobots_writer(everything: Path) -> None:
    files = {str(path.relative_to(everything)) for path in everything.rglob("*") if path.is_file()}
    extra = {f"{EXTRA_FOLDER}/{file}" for file in FROZEN["extra"]["files"]}
    assert files == {*FROZEN["main"]["files"], *extra, "meta/rig.json", "README.md", "export.json"}


def test_both_datasets_have_the_same_rows(everything: Path) -> None:
    one, two = (pq.read_table(everything / folder / DATA) for folder in PARTS.values())
    for name in ("timestamp", "frame_index", "episode_index", "index", "task_index", "origin", "camera_pose.front"):
        assert one[name].to_pylist() == two[name].to_pylist()
    tables = [pq.read_table(everything / folder / "meta/tasks.parquet") for folder in PARTS.values()]
    assert tables[0].to_pylist() == tables[1].to_pylist()


def test_rows_contain_the_recorded_values(everything: Path) -> None:
    rows, episodes = pq.read_table(everything / DATA), pq.read_table(everything / EPISODES).to_pylist()
    tasks = pq.read_table(everything / "meta/tasks.parquet").to_pylist()
    assert [row["episode_id"] for row in episodes] == list(ORDER)
    assert pq.ParquetFile(everything / DATA).num_row_groups == len(ORDER)
    for number, row in enumerate(episodes):
        parts = episode_parts(int(row["episode_id"][3:]))
        part = rows.slice(row["dataset_from_index"], row["length"])
        assert row["length"] == len(parts.frames)
        assert np.array_equal(column(part, "action"), parts.arrays.actions_continuous)
        assert np.array_equal(column(part, "tokens"), parts.arrays.actions_tokens)
        assert np.array_equal(column(part, "pose"), parts.arrays.poses.astype(np.float32))
        assert set(column(part, "episode_index")) == {number}
        assert np.array_equal(column(part, "index"), row["dataset_from_index"] + np.arange(row["length"]))
        assert np.allclose(column(part, "timestamp"), np.arange(row["length"]) / 60)
        said = {tasks[index]["task"] for index in column(part, "task_index")}
        assert said == {parts.meta.job.instruction} == set(row["tasks"])
        shown = pq.read_table(everything / EXTRA_FOLDER / DATA).slice(row["dataset_from_index"], row["length"])
        for found, frame in zip(shown[IDS].to_pylist(), parts.frames, strict=True):
            assert np.array_equal(np.asarray(Image.open(io.BytesIO(found["bytes"]))), frame[2])


@pytest.mark.parametrize("name", ["everything", "slow"])
def test_the_last_frame_of_a_success_has_the_reward(name: str, request: pytest.FixtureRequest) -> None:
    root = request.getfixturevalue(name)
    rows = pq.read_table(root / DATA)
    last = column(rows, "frame_index") == np.repeat([n - 1 for n in lengths_of(root)], lengths_of(root))
    assert last.sum() == len(ORDER)
    for key in ("next.reward", "next.success", "next.done"):
        assert np.array_equal(column(rows, key), last)
    assert not set(types_of(root / DATA)) & {"reward", "success", "done"}
    stats = json.loads((root / "meta/stats.json").read_text())
    assert stats["next.reward"]["mean"] == pytest.approx([last.mean()])
    assert (stats["next.done"]["min"], stats["next.done"]["max"]) == ([0.0], [1.0])


def lengths_of(root: Path) -> list[int]:
    found: list[int] = pq.read_table(root / EPISODES)["length"].to_pylist()
    return found


def test_an_episode_without_success_ends_without_reward() -> None:
    outcome = outcome_columns(3, is_success=False)
    assert [values.tolist() for values in outcome.values()] == [[0.0] * 3, [False] * 3, [False, False, True]]
    assert [values.dtype for values in outcome.values()] == [np.float32, np.bool_, np.bool_]


def test_splits_are_ranges_of_episodes(everything: Path) -> None:
    info = info_of(everything)
    assert info["splits"] == {"train_id": "0:2", "test_id": "2:3", "test_paraphrase_ood": "3:4"}
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (4, sum(STEPS), 2)
    splits = pq.read_table(everything / EPISODES)["split"].to_pylist()
    assert splits == ["train_id", "train_id", "test_id", "test_paraphrase_ood"]


@pytest.mark.parametrize(("key", "pixels"), [(RGB, "rgb24"), (DEPTH, "gray12le")])
def test_videos_show_every_frame_at_its_time(everything: Path, key: str, pixels: str) -> None:
    root = everything / EXTRA_FOLDER if key == DEPTH else everything
    episodes = pq.read_table(root / EPISODES).to_pylist()
    frames = list(read_video(root / f"videos/{key}/chunk-000/file-000.mp4", pixels))
    assert len(frames) == sum(STEPS)
    assert [time for time, _, _ in frames] == pytest.approx([number / 60 for number in range(len(frames))])
    code = DepthCode(FAR_M)
    for row in episodes:
        parts = episode_parts(int(row["episode_id"][3:]))
        first = round(row[f"videos/{key}/from_timestamp"] * 60)
        assert first == row["dataset_from_index"]
        assert row[f"videos/{key}/to_timestamp"] == pytest.approx((first + row["length"]) / 60)
        assert frames[first][1], "an episode begins with a key frame"
        for (_, _, found), (rgb, depth, _) in zip(frames[first : first + row["length"]], parts.frames, strict=True):
            if key == DEPTH:
                assert np.array_equal(found, code.encode(depth))
            else:
                assert 10 * np.log10(255**2 / np.mean((found.astype(float) - rgb) ** 2)) > 30


def test_slower_export_keeps_every_third_frame_and_the_mean_of_its_commands(slow: Path) -> None:
    rows, episodes = pq.read_table(slow / DATA), pq.read_table(slow / EPISODES).to_pylist()
    assert info_of(slow)["fps"] == 20
    assert not (slow / EXTRA_FOLDER).exists()
    frames = list(read_video(slow / f"videos/{RGB}/chunk-000/file-000.mp4"))
    assert len(frames) == rows.num_rows == sum(-(-steps // 3) for steps in STEPS)
    for row in episodes:
        parts = episode_parts(int(row["episode_id"][3:]))
        part = rows.slice(row["dataset_from_index"], row["length"])
        actions = parts.arrays.actions_continuous
        means = np.array([actions[t : t + 3].mean(axis=0) for t in range(0, len(actions), 3)])
        assert column(part, "action") == pytest.approx(means, abs=1e-6)
        assert np.array_equal(column(part, "tokens"), tokens_of(column(part, "action").astype(np.float32)))
        assert np.array_equal(column(part, "pose"), parts.arrays.poses[::3].astype(np.float32))
        assert column(part, "timestamp") == pytest.approx(np.arange(row["length"]) / 20)
        for place, t in enumerate(range(0, len(actions), 3)):
            found = frames[row["dataset_from_index"] + place][2].astype(float)
            assert 10 * np.log10(255**2 / np.mean((found - parts.frames[t][0]) ** 2)) > 30


def test_statistics_are_those_of_the_values(everything: Path) -> None:
    rows, episodes = pq.read_table(everything / DATA), pq.read_table(everything / EPISODES).to_pylist()
    whole = json.loads((everything / "meta/stats.json").read_text())
    part = column(rows.slice(episodes[1]["dataset_from_index"], episodes[1]["length"]), "observation.state")
    assert episodes[1]["stats/observation.state/mean"] == pytest.approx(part.mean(axis=0), abs=1e-6)
    assert episodes[1]["stats/observation.state/q90"] == pytest.approx(np.quantile(part, 0.9, axis=0), abs=1e-6)
    for name in ("action", "observation.state", "pose", "timestamp"):
        values = column(rows, name).reshape(rows.num_rows, -1)
        assert whole[name]["mean"] == pytest.approx(values.mean(axis=0), abs=1e-6)
        assert whole[name]["std"] == pytest.approx(values.std(axis=0), abs=1e-5)
        assert whole[name]["min"] == pytest.approx(values.min(axis=0))
        assert whole[name]["max"] == pytest.approx(values.max(axis=0))
        spread = np.ptp(values, axis=0).max()
        median = np.quantile(values, 0.5, axis=0, method="inverted_cdf")
        assert whole[name]["q50"] == pytest.approx(median, abs=spread / 2000 + 1e-9)
    seen = np.stack([rgb[::4, ::4] for index in (2, 4, 3, 1) for rgb, _, _ in episode_parts(index).frames]) / 255
    assert np.ravel(whole[RGB]["mean"]) == pytest.approx(seen.mean(axis=(0, 1, 2)), abs=1e-6)
    assert np.ravel(whole[RGB]["std"]) == pytest.approx(seen.std(axis=(0, 1, 2)), abs=1e-6)
    assert np.shape(whole[RGB]["q99"]) == (3, 1, 1)
    assert whole[RGB]["count"] == [sum(STEPS)]
    extra = json.loads((everything / EXTRA_FOLDER / "meta/stats.json").read_text())
    assert np.ravel(extra[DEPTH]["min"]) == [0.0]
    assert np.ravel(extra[DEPTH]["max"]) == pytest.approx([3.0], abs=0.002)
    assert np.ravel(extra[IDS]["max"]) == [7.0]


def test_version_2_1_has_one_file_for_each_episode(older: Path) -> None:
    info = info_of(older)
    assert (info["codebase_version"], info["fps"], info["total_videos"], info["total_chunks"]) == ("v2.1", 30, 4, 1)
    lines = [json.loads(line) for line in (older / "meta/episodes.jsonl").read_text().splitlines()]
    tasks = [json.loads(line)["task"] for line in (older / "meta/tasks.jsonl").read_text().splitlines()]
    stats = [json.loads(line) for line in (older / "meta/episodes_stats.jsonl").read_text().splitlines()]
    assert [line["episode_id"] for line in lines] == list(ORDER)
    assert [line["episode_index"] for line in stats] == [0, 1, 2, 3]
    for line in lines:
        place = {"episode_chunk": 0, "episode_index": line["episode_index"], "video_key": RGB}
        table = pq.read_table(older / info["data_path"].format(**place))
        frames = list(read_video(older / info["video_path"].format(**place)))
        parts = episode_parts(int(line["episode_id"][3:]))
        assert len(frames) == table.num_rows == line["length"] == -(-len(parts.frames) // 2)
        assert np.array_equal(column(table, "pose"), parts.arrays.poses[::2].astype(np.float32))
        assert column(table, "next.reward").tolist() == [0.0] * (len(frames) - 1) + [1.0]
        assert column(table, "next.success").tolist() == column(table, "next.done").tolist()
        assert np.flatnonzero(column(table, "next.done")).tolist() == [len(frames) - 1]
        assert {tasks[index] for index in column(table, "task_index")} == {parts.meta.job.instruction}
        assert [time for time, _, _ in frames] == pytest.approx(column(table, "timestamp").tolist())


def test_modality_covers_the_whole_state_and_action(older: Path) -> None:
    assert json.loads((older / "meta/modality.json").read_text()) == MODALITY
    features = info_of(older)["features"]
    state = sorted((part["start"], part["end"]) for part in MODALITY["state"].values())
    assert [state[0][0], state[-1][1]] == [0, features["observation.state"]["shape"][0]]
    assert all(one[1] == two[0] for one, two in pairwise(state))
    assert MODALITY["video"]["front"]["original_key"] in features
    stats = json.loads((older / "meta/stats.json").read_text())
    for part in (*MODALITY["state"].values(), *MODALITY["action"].values()):
        assert np.issubdtype(part["dtype"], np.number)
    for key in ("observation.state", "action", "tokens"):  # GR00T takes each part of `MODALITY` out of every statistic
        assert {len(values) for values in stats[key].values()} == {features[key]["shape"][0]}


def test_version_2_1_uses_the_list_type_of_its_readers(older: Path) -> None:
    """`datasets` 3, which LeRobot 0.3 requires, does not have `List`; version 4 still reads `Sequence`."""
    (path, *_) = sorted(older.glob("data/*/*.parquet"))
    described = json.loads(pq.read_schema(path).metadata[b"huggingface"])["info"]["features"]
    lists = {name for name, feature in described.items() if "length" in feature}
    assert lists == {"observation.state", "action", "tokens", "pose", "camera_pose.front", "camera_matrix.front"}
    assert {described[name]["_type"] for name in lists} == {"Sequence"}


def test_files_are_split_at_their_size_limit(varied: Path, tmp_path: Path) -> None:
    shutil.copytree(varied, tmp_path / "data")
    # an episode is missing, so the export is incomplete and does not delete its pieces
    (tmp_path / "data/episodes/ep_000003.zip").unlink()
    options, out = LeRobotOptions(fps=10), tmp_path / "out"
    assert not run_export(ExportOrder(tmp_path / "data", out, "lerobot", options)).complete
    dataset = Dataset(varied)
    with Output(out) as output:
        pieces = [
            ExportPiece(
                dataset, n, row.episode_id, str(row.summary.split), *places(output, row.episode_id), LeRobotFacts
            )
            for n, row in enumerate(dataset)
            if row.episode_id != "ep_000003"
        ]
        write_dataset(Finish(dataset, options, pieces, output), FileLimits(2, 0, 0, 1))
    names = ["chunk-000/file-000", "chunk-000/file-001", "chunk-001/file-000"]
    for number, name in enumerate(names):
        (row,) = pq.read_table(out / f"meta/episodes/{name}.parquet").to_pylist()
        assert row["episode_index"] == number
        for kind in ("data", f"videos/{RGB}", "meta/episodes"):
            assert f"chunk-{row[f'{kind}/chunk_index']:03d}/file-{row[f'{kind}/file_index']:03d}" == name
        assert pq.read_table(out / f"data/{name}.parquet").num_rows == row["length"]
        assert row[f"videos/{RGB}/from_timestamp"] == 0.0
        assert len(list(read_video(out / f"videos/{RGB}/{name}.mp4"))) == row["length"]


def places(output: Output, name: str) -> tuple[Path, Path]:
    return output.piece_folder(name), output.facts_path(name)


def test_rate_that_does_not_divide_is_refused(varied: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--fps 25: the dataset has 60 frames per second; valid values: 1, 2, 3"):
        export(varied, tmp_path / "out", "lerobot", fps=25)
    assert not (tmp_path / "out").exists()


def test_state_is_odometry_from_the_first_frame() -> None:
    """A quarter circle to the left of radius 1 m within one second, from (3, 2) facing +y."""
    t = np.linspace(0, 1, 61)
    yaw = np.pi / 2 + t * np.pi / 2
    poses = np.zeros((61, 7))
    poses[:, 0], poses[:, 1] = 3 - 1 + np.cos(yaw - np.pi / 2), 2 + np.sin(yaw - np.pi / 2)
    poses[:, 3], poses[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    state = frame_columns(np.zeros((61, 2), np.float32), poses, 60, 1).state
    assert state[0] == pytest.approx([0, 0, 0, 0, 0], abs=1e-6)
    assert state[-1, :3] == pytest.approx([1, 1, np.pi / 2], abs=1e-5)
    assert state[1:, 3] == pytest.approx(np.full(60, np.pi / 2), abs=1e-3)
    assert state[1:, 4] == pytest.approx(np.full(60, np.pi / 2), abs=1e-3)
    assert np.array_equal(frame_columns(np.zeros((61, 2), np.float32), poses, 60, 6).state, state[::6])


def test_the_last_window_of_commands_is_averaged_over_the_remaining_steps() -> None:
    actions = np.array([[0.0, 0], [0.3, 1], [0.6, -1], [1.0, 0.5]], np.float32)
    poses = np.zeros((4, 7))
    poses[:, 3] = 1
    assert frame_columns(actions, poses, 60, 3).action == pytest.approx(np.array([[0.3, 0], [1.0, 0.5]]), abs=1e-6)
    assert np.array_equal(frame_columns(actions, poses, 60, 1).action, actions)


def test_the_depth_encoding_keeps_zero_and_has_an_error_of_at_most_half_a_step() -> None:
    code = DepthCode(FAR_M)
    depth = np.linspace(0, FAR_M, 100_001, dtype=np.float32).reshape(1, -1)
    codes = code.encode(depth)
    assert codes.dtype == np.uint16
    assert (codes[0, 0], codes[0, -1]) == (0, 4095)
    assert code.decode(codes[:, :1])[0, 0] == 0.0
    error = np.abs(code.decode(codes) - depth)
    half_step = (depth + 3.5) * np.log(33.5 / 3.5) / 4095 / 2
    assert (error <= half_step * 1.01 + 1e-6).all()
