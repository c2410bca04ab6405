"""Runs the snippets of docs/formats and of the README of each export on the export that they belong to.

Snippets for LeRobot run in its own environments, by `tests/readers/lerobot_reader.py` and `lerobot_v21_reader.py`
(`make test-formats`).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from braceexpand import braceexpand

from factory.export.execution.export_run import ExportOrder, run_export
from factory.export.registry import EXPORTERS, find_exporter
from schemas.terms import Recording
from tests.readers.snippets import run_snippets, snippets_of

pytestmark = pytest.mark.gl
DOCS = Path(__file__).parents[2] / "docs" / "formats"
IN_OTHER_ENVIRONMENTS = r"(from|import) lerobot\b"
PACKAGES = {
    "README.md": {"webdataset": "webdataset", "rosbags": "mcap", "pycocotools": "coco", "tarfile": "webdataset"}
}
"""Page -> package of a snippet -> format of its export."""
SLOW: dict[str, Any] = {"fps": 5}
OPTIONS = {
    "mcap": SLOW | {"ros2": True},
    "coco": SLOW,
    "lerobot": SLOW,
    "lerobot-v2.1": SLOW,
    "rlds": SLOW,
    "robomimic": SLOW,
    "webdataset": SLOW | {"shard_mb": 1},
}


ELSEWHERE = {
    "mcap": {"meta.json"},  # attachment of each file
    "webdataset": {"action.json"},  # member of each sample
    "gnm": {"vint_train/data/data_config.yaml"},  # of the reader
    "lerobot": {"meta.json"},  # of the original dataset
    "lerobot-v2.1": {"meta.json"},
}
"""Format -> files that its README names, but that are not files of the export."""


@pytest.fixture(scope="module")
def exports(recordings: dict[Recording, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """An export in every format."""
    place = tmp_path_factory.mktemp("exports")
    for name in EXPORTERS:
        options = find_exporter(name).options.model_validate(OPTIONS.get(name, {}))
        assert run_export(ExportOrder(recordings[Recording.FRAMES], place / name / "out", name, options)).complete
    return {name: place / name / "out" for name in EXPORTERS}


def here(page: Path) -> list[str]:
    return [code for code in snippets_of(page) if not re.search(IN_OTHER_ENVIRONMENTS, code)]


@pytest.mark.parametrize(("package", "name"), PACKAGES["README.md"].items())
def test_snippets_of_the_documents_run(exports: dict[str, Path], package: str, name: str) -> None:
    assert run_snippets(DOCS / "README.md", exports[name].parent, package) == 1


def test_every_snippet_of_the_documents_is_run_by_a_test() -> None:
    for page in DOCS.rglob("*.md"):
        known = PACKAGES.get(page.name, {}) if page.parent == DOCS else {}
        unknown = [code for code in here(page) if not any(package in code for package in known)]
        assert unknown == [], f"{page} has a snippet that no test runs"


def test_the_snippet_of_a_webdataset_export_runs(exports: dict[str, Path]) -> None:
    out = exports["webdataset"]
    assert run_snippets(out / "README.md", out, "webdataset") == 1
    pattern = re.search(r'WebDataset\("(.*?)"', (out / "README.md").read_text())
    assert pattern is not None
    shards = sorted(path.name for path in out.glob("*.tar"))
    assert len(shards) > 1
    assert list(braceexpand(pattern[1])) == shards


@pytest.mark.parametrize("name", EXPORTERS)
def test_no_other_export_prints_a_python_snippet(exports: dict[str, Path], name: str) -> None:
    assert len(here(exports[name] / "README.md")) == (1 if name == "webdataset" else 0)


def test_the_configuration_that_gnm_prints_names_existing_folders(exports: dict[str, Path]) -> None:
    out = exports["gnm"]
    (block,) = re.findall(r"^```yaml\n(.*?)^```", (out / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    config = yaml.safe_load(block.replace("<here>", str(out)))["datasets"]["minivla_nav"]
    for key in ("data_folder", "train", "test"):
        assert Path(config[key]).is_dir(), key
    assert yaml.safe_load((out / "data_config.yaml").read_text()).keys() == {"minivla_nav"}


def test_the_lines_that_internnav_and_navdp_print_name_existing_folders(exports: dict[str, Path]) -> None:
    out = exports["internnav"]
    lines = re.findall(r"^    (.*)$", (out / "README.md").read_text(), re.MULTILINE)
    names: dict[str, Any] = {"data_dict": {}}
    exec("\n".join(lines).replace("<here>", str(out)), names)
    entry = names["data_dict"]["minivla"]
    assert Path(entry["data_path"]).is_dir()
    (table,) = list(Path(entry["data_path"]).glob("*/data/*/episode_000001.parquet"))
    assert table.is_file()
    text = (exports["navdp"] / "README.md").read_text()
    assert (exports["navdp"] / re.search(r"Pass `(\w+)` as `root_dirs`", text)[1]).is_dir()  # type: ignore[index]


@pytest.mark.parametrize("name", EXPORTERS)
def test_files_that_a_readme_names_exist(exports: dict[str, Path], name: str) -> None:
    out = exports[name]
    cited = set(re.findall(r"`([\w./-]+\.(?:json|jsonl|parquet|yaml|npy|ply|txt))`", (out / "README.md").read_text()))
    files = [str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()]
    gone = [file for file in cited - ELSEWHERE.get(name, set()) if not any(each.endswith(file) for each in files)]
    assert gone == []


@pytest.mark.parametrize("name", EXPORTERS)
def test_a_readme_states_robot_and_success_of_the_plan(exports: dict[str, Path], name: str) -> None:
    text = " ".join((exports[name] / "README.md").read_text().split())
    assert (
        "A Nova Carter gets an instruction in English that names an object; it stops within 1.4 m of its centre."
        in text
    )
    assert not re.search(r"\b(1|2|3)th\b", text)
    if name in ("vlnce", "internnav"):
        assert "30" in text
        assert "60 Hz" not in text
        assert "1/60 s" not in text
