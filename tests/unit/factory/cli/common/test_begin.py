"""Checks of the output directory of a run before building."""

from __future__ import annotations

from pathlib import Path

import pytest

from factory.cli.common.begin import begin
from factory.dataset.site import site_of
from schemas.errors import UsageError, WorldError


def test_a_directory_that_cannot_be_read_is_an_error_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", denied)  # root reads everything
    with pytest.raises(WorldError, match=f"cannot look into {tmp_path}: Permission denied"):
        begin("demo", site_of(str(tmp_path)), {})


def test_a_new_directory_is_new_and_one_within_a_dataset_is_refused(tmp_path: Path) -> None:
    assert begin("demo", site_of(str(tmp_path / "new")), {}).is_new
    (tmp_path / "dataset_meta.json").write_text("{}")
    with pytest.raises(UsageError, match=f"is inside the dataset {tmp_path}"):
        begin("demo", site_of(str(tmp_path / "new")), {})
