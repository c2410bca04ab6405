"""The spec file: description, subsets, and refusal of invalid files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from factory.eval.models.spec import SPECS_FORMAT, read_specs, write_specs
from schemas.errors import UsageError
from schemas.terms import Split
from tests.builders.eval_results import spec_of, specs_of

SET = specs_of(*(spec_of(n, split=Split.TEST_ID if n % 2 else Split.TEST_OOD_OBJ) for n in range(1, 11)))


def test_a_file_of_specs_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    write_specs(SET, tmp_path / "s.json")
    assert read_specs(tmp_path / "s.json") == SET
    assert read_specs(tmp_path / "s.json").digest == SET.digest
    assert [path.name for path in tmp_path.iterdir()] == ["s.json"]


def test_the_digest_covers_the_episodes_and_not_their_description() -> None:
    assert SET.model_copy(update={"source": "elsewhere"}).digest == SET.digest
    moved = SET.specs[0].model_copy(update={"spawn_pose": (0.0, 0.0, 0.1)})
    assert specs_of(moved, *SET.specs[1:]).digest != SET.digest
    assert SET.spec_digest(moved) != SET.spec_digest(SET.specs[0])


def test_a_subset_is_spread_over_the_list_and_recorded() -> None:
    part = SET.only(None, 5)
    assert [spec.spec_id for spec in part.specs] == [f"ep_{n:06d}" for n in (1, 3, 5, 7, 9)]
    assert part.source.endswith("5 of 10")
    assert len(SET.only(frozenset({Split.TEST_ID})).specs) == 5
    with pytest.raises(UsageError, match="no episodes in val_id; splits of the specs: test_id, test_ood_obj"):
        SET.only(frozenset({Split.VAL_ID}))


def test_two_specs_with_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="ep_000001"):
        specs_of(spec_of(1), spec_of(1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not a valid specs file"),
        ("{}", "is not a valid specs file"),
        (json.dumps({"format": SPECS_FORMAT + 1}), "upgrade minivla-factory"),
    ],
)
def test_the_error_of_an_invalid_file_names_the_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(UsageError, match=message) as caught:
        read_specs(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_refused_with_the_command_that_writes_it(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="factory eval specs"):
        read_specs(tmp_path / "none.json")
