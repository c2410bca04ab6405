"""One plan recorded as states and as frames: equal episodes, equal rendered dataset, equal exports."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.acceptance.compare_recordings import EXPORTS, Difference, compare_datasets, compare_trees
from tests.acceptance.factory_cli import Command, FactoryCli
from tests.builders.shared import build_once

pytestmark = [pytest.mark.gl, pytest.mark.slow]


@pytest.fixture(scope="session")
def rendered(factory: FactoryCli, states: Path, shared: Path) -> Path:
    """The dataset that `factory render` makes of `states`; tests only read it."""
    return build_once(shared / "reference-rendered", lambda root: factory("render", states, "-o", root))


def unexpected(found: list[Difference]) -> list[Difference]:
    return [one for one in found if not one.is_expected]


def test_both_recordings_have_equal_episodes_and_tables(reference: Path, states: Path) -> None:
    assert unexpected(compare_datasets(reference, states, same_recording=False)) == []


def test_the_rendered_dataset_equals_the_frames_recording(reference: Path, rendered: Path) -> None:
    assert unexpected(compare_datasets(reference, rendered, same_recording=True)) == []


def test_a_changed_value_is_found(reference: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(reference, tmp_path / "copy"))
    meta = json.loads((copy / "dataset_meta.json").read_text())
    (copy / "dataset_meta.json").write_text(json.dumps({**meta, "seed": 7}))
    (copy / "README.md").write_text("another card")
    (found,) = unexpected(compare_datasets(reference, copy, same_recording=False))
    assert found.what == "dataset_meta.json: seed"
    assert len(unexpected(compare_datasets(reference, copy, same_recording=True))) == 2


@pytest.mark.parametrize(("export", "sample"), [("paper", ()), ("lerobot", ("--fps", 5)), ("webdataset", ())])
def test_exports_of_both_recordings_are_equal_byte_by_byte(
    command: Command, reference: Path, states: Path, tmp_path: Path, export: str, sample: tuple[object, ...]
) -> None:
    words = ("--to", export, *EXPORTS[export], *sample, "--episode", "1-2", "--workers", 1)
    for name, root in (("frames", reference), ("states", states)):
        command("export", root, *words, "-o", tmp_path / name)
    assert compare_trees(tmp_path / "frames", tmp_path / "states") == []
    (tmp_path / "states" / "export.json").write_text("{}")
    assert [one.what for one in compare_trees(tmp_path / "frames", tmp_path / "states")] == ["export.json"]
