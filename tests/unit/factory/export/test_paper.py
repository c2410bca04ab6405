"""The paper's tree: every frame and array equals the content of the bundle."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from PIL import Image

from factory.dataset.reader import Dataset, Episode
from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.options import PaperOptions
from schemas.dataset.meta import read_dataset_meta
from schemas.dataset.rows import PUBLISHED_COLUMNS
from schemas.encoding.digest import content_digest, frame_digest
from tests.unit.factory.export.varied import STEPS


def test_the_tree_has_the_content_of_the_bundles(varied: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run_export(ExportOrder(varied, out, "paper", PaperOptions())).complete
    for episode in Dataset(varied):
        folder = out / "episodes" / episode.episode_id
        expected = {f"{kind}/{t:06d}.{end}" for kind, end in KINDS for t in range(len(episode))}
        expected |= {"actions_continuous.npy", "actions_tokens.npy", "poses.npy", "meta.json", "origin.json"}
        assert {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} == expected
        assert json.loads((folder / "meta.json").read_text()) == without_time_and_worker(episode)
        digests = [frame_digest(*frame(folder, t)) for t in range(len(episode))]
        assert tuple(digests) == episode.meta.frame_digests
        arrays = [np.load(folder / f"{name}.npy") for name in ("actions_continuous", "actions_tokens", "poses")]
        assert content_digest(digests, arrays, episode.meta.canonical()) == episode.summary.content_digest


def without_time_and_worker(episode: Episode) -> dict[str, Any]:
    values = json.loads(episode.stored("meta.json"))
    del values["provenance"]["created_at"], values["provenance"]["worker"]
    return values


KINDS = (("rgb_front", "png"), ("depth_front", "npy"), ("seg_front", "png"))


def frame(folder: Path, t: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reads a frame with third-party libraries only."""
    rgb = np.asarray(Image.open(folder / f"rgb_front/{t:06d}.png"))
    ids = np.asarray(Image.open(folder / f"seg_front/{t:06d}.png"))
    return rgb, np.load(folder / f"depth_front/{t:06d}.npy"), ids.astype(np.uint16)


def test_tables_describe_the_tree(varied: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run_export(ExportOrder(varied, out, "paper", PaperOptions()))
    rows = pq.read_table(out / "metadata.parquet")
    assert tuple(rows.column_names[: len(PUBLISHED_COLUMNS)]) == PUBLISHED_COLUMNS
    assert not {"file_sha256", "file_name", "file_bytes", "created_at", "worker"} & set(rows.column_names)
    assert rows["num_steps"].to_pylist() == list(STEPS)
    expected = read_dataset_meta(varied).model_dump(mode="json", exclude={"created_at", "updated_at"})
    assert description(out) == expected


def description(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "dataset_meta.json").read_text())
    return found


def test_an_export_of_a_subset_records_it(varied: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    report = run_export(ExportOrder(varied, out, "paper", PaperOptions(), splits=("train_id",)))
    assert (report.episodes, report.frames) == (2, 35)
    meta = description(out)
    assert (meta["episodes"], meta["complete"], meta["dataset_digest"]) == (2, False, None)
    assert sorted(path.name for path in (out / "episodes").iterdir()) == ["ep_000002", "ep_000004"]


def test_the_published_name_of_a_split_is_written_on_request(varied: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run_export(ExportOrder(varied, out, "paper", PaperOptions(split_names="published")))
    splits = pq.read_table(out / "metadata.parquet")["split"].to_pylist()
    assert splits == ["test_ood_lang", "train_id", "test_id", "train_id"]
    texts = [json.loads((out / f"episodes/ep_00000{number}/meta.json").read_text()) for number in (1, 2)]
    assert [text["job"]["split"] for text in texts] == ["test_ood_lang", "train_id"]
    original = without_time_and_worker(Dataset(varied)["ep_000001"])
    assert {**texts[0], "job": {**texts[0]["job"], "split": "test_paraphrase_ood"}} == original
