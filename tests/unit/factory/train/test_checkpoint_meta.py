"""Metadata and refusal of checkpoints; needs no torch."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from pydantic import ValidationError

from factory.train.checkpoint import checkpoint_path, parse_meta, write_atomically
from factory.train.options import BcOptions, CheckpointMeta, TrainingStarts
from factory.train.vocabulary import vocabulary
from schemas.errors import UsageError

PATH = Path("policy.pt")


def meta(**changes: object) -> CheckpointMeta:
    values = {
        "options": BcOptions(epochs=2),
        "words": vocabulary(),
        "control_hz": 60,
        "fov_deg": 90.0,
        "max_speed_mps": 1.0,
        "max_yaw_rate_rps": 1.5,
        "train_digest": "0" * 64,
        "train_episodes": 3,
        "train_frames": 40,
        "software": "none",
    }
    return CheckpointMeta.model_validate(values | changes)


def test_metadata_is_read_back_from_json() -> None:
    assert parse_meta(meta(epochs_done=2).model_dump_json(), PATH) == meta(epochs_done=2)


@pytest.mark.parametrize("changes", [{"format": 4, "field_of_a_later_version": 1}, {"look": 99}])
def test_the_error_of_another_version_names_its_number(changes: dict[str, int]) -> None:
    text = json.dumps(json.loads(meta().model_dump_json()) | changes)
    with pytest.raises(UsageError, match=r"another version .*(format 4|preprocessing 99)"):
        parse_meta(text, PATH)


@pytest.mark.parametrize("text", [None, 7, "", "{}", '{"kind": "other"}'])
def test_invalid_metadata_is_refused(text: object) -> None:
    with pytest.raises(UsageError, match=r"policy\.pt is not a checkpoint"):
        parse_meta(text, PATH)


def test_a_training_folder_can_be_given_as_policy(tmp_path: Path) -> None:
    assert checkpoint_path(tmp_path) == tmp_path / "policy.pt"
    assert checkpoint_path(tmp_path / "mine.pt") == tmp_path / "mine.pt"


def test_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "metrics.json"
    write_atomically(path, b"one")
    write_atomically(path, b"two")
    assert path.read_bytes() == b"two"
    assert [found.name for found in tmp_path.iterdir()] == ["metrics.json"]


@pytest.mark.parametrize("changes", [{"size": 100}, {"epochs": 0}, {"head": "both"}, {"peak_rate": 0}])
def test_invalid_options_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        BcOptions.model_validate(changes)


def test_a_checkpoint_of_format_2_states_no_training_episodes() -> None:
    content = json.loads(meta().model_dump_json()) | {"format": 2}
    assert "starts" not in content
    assert parse_meta(json.dumps(content), PATH).starts is None


def test_an_episode_is_recognised_by_scene_target_and_start() -> None:
    starts = TrainingStarts(scenes={"a" * 64: {"crate_001": ((1.0, 2.0, math.pi),)}})
    assert starts.holds("a" * 64, "crate_001", (1.004, 2.0, -math.pi + 0.001))
    assert not starts.holds("b" * 64, "crate_001", (1.0, 2.0, math.pi))
    assert not starts.holds("a" * 64, "barrel_001", (1.0, 2.0, math.pi))
    assert not starts.holds("a" * 64, "crate_001", (1.02, 2.0, math.pi))
    assert not starts.holds("a" * 64, "crate_001", (1.0, 2.0, math.pi - 0.05))
