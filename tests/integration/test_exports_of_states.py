"""Exports of a states dataset: the images and arrays of an export of a frames dataset, byte by byte."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.export.execution.run import ExportOrder, run_export
from factory.export.output import WORK_FOLDER
from factory.export.registry import find_exporter
from schemas.terms import Recording

pytestmark = pytest.mark.gl


def exported(root: Path, out: Path, name: str) -> dict[str, bytes]:
    options = find_exporter(name).options()
    assert run_export(ExportOrder(root=root, out=out, format=name, options=options)).complete
    files = {path.relative_to(out): path for path in out.rglob("*") if path.is_file()}
    return {str(file): path.read_bytes() for file, path in files.items() if file.parts[0] != WORK_FOLDER}


@pytest.mark.parametrize("name", ["webdataset", "gnm", "lerobot", "paper"])
def test_an_export_has_the_same_files(recordings: dict[Recording, Path], tmp_path: Path, name: str) -> None:
    frames, states = (exported(recordings[record], tmp_path / str(record), name) for record in Recording)
    assert frames.keys() == states.keys()
    differing = {file for file, data in frames.items() if states[file] != data}
    assert differing == {name}
