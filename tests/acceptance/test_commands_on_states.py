"""Every command that reads a dataset gives the same result for a frames recording and a states recording."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

from schemas.terms import Recording
from tests.acceptance.compare_recordings import compare_trees
from tests.acceptance.factory_cli import Command

pytestmark = pytest.mark.gl
Recordings = dict[Recording, Path]
DATA, OUT = "DATA", "OUT"
"""Placeholders for the dataset and for a new file or folder."""
OF_RECORDING = {
    "dataset",
    "run",
    "source",
    "digest",
    "dataset_digest",
    "archived_digest",
    "replayed_digest",
    "seconds",
    "act_ms",
    "difference",
}
"""Values that may differ: they identify the dataset, measure time, or compare rendered frames."""
PRINTING = {
    "stats": ("stats", DATA),
    "stats --language": ("stats", DATA, "--language"),
    "verify": ("verify", DATA, "--deep", "--render", "all"),
    "replay": ("replay", DATA, 2),
}
WRITING = {
    "show a sheet": ("show", DATA, 1, "-o", f"{OUT}.png"),
    "show a film": ("show", DATA, 2, "-o", f"{OUT}.gif"),
}
EVALUATED = ("--policy", "stop", "--policy", "replay", "--policy", "playback", "--policy", "expert")


def filled(words: tuple[object, ...], data: Path, out: Path) -> list[str]:
    return [str(word).replace(DATA, str(data)).replace(OUT, str(out)) for word in words]


def without_names(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_names(item) for key, item in value.items() if key not in OF_RECORDING}
    return [without_names(item) for item in value] if isinstance(value, list) else value


@pytest.mark.parametrize("name", PRINTING)
def test_a_command_prints_the_same_values(command: Command, recordings: Recordings, name: str) -> None:
    printed = [command.json(*filled(PRINTING[name], recordings[record], Path())) for record in Recording]
    assert without_names(printed[0]) == without_names(printed[1]) != {}
    assert [found["difference"]["differing"] for found in printed if "difference" in found] in ([0, 0], [])


@pytest.mark.parametrize("name", WRITING)
def test_a_command_writes_the_same_file(command: Command, recordings: Recordings, tmp_path: Path, name: str) -> None:
    files = []
    for record in Recording:
        command(*filled(WRITING[name], recordings[record], tmp_path / record))
        (file,) = tmp_path.glob(f"{record}.*")
        files.append(file.read_bytes())
    assert files[0] == files[1]


@pytest.mark.slow
def test_a_report_has_the_same_figures(command: Command, recordings: Recordings, tmp_path: Path) -> None:
    for record in Recording:
        command("report", recordings[record], "-o", tmp_path / record)
    assert [one.what for one in compare_trees(*(tmp_path / record for record in Recording))] == [
        "report.html",
        "report.json",
    ]


@pytest.mark.slow
def test_an_evaluation_has_the_same_results(command: Command, recordings: Recordings, tmp_path: Path) -> None:
    results = []
    for record in Recording:
        command("eval", recordings[record], "--split", "train_id", *EVALUATED, "-o", tmp_path / record)
        results.append(json.loads((tmp_path / record / "results.json").read_text()))
    assert without_names(results[0]) == without_names(results[1])


@pytest.mark.skipif(importlib.util.find_spec("rerun") is None, reason="needs the extra view")
def test_a_viewer_recording_of_states_is_written(command: Command, recordings: Recordings, tmp_path: Path) -> None:
    shown = command.json("view", recordings[Recording.STATES], 1, "-o", tmp_path / "e.rrd", "--stride", 20)
    assert (shown["frames"], (tmp_path / "e.rrd").stat().st_size > 0) == (-(-shown["steps"] // 20), True)
