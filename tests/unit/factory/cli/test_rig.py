"""`factory rig list`, `show` and `check`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from factory.cli.rig import command
from schemas.builtin import BUILTIN_RIGS
from schemas.errors import InvalidRig
from schemas.rig.rig_file import load_rig


def output_of(*arguments: str) -> str:
    """Returns the output of `factory rig`."""
    result = CliRunner(catch_exceptions=False).invoke(command, arguments)
    assert result.exit_code == 0
    return result.stdout


def test_the_built_in_rigs_are_listed():
    assert [row["name"] for row in json.loads(output_of("list", "--json"))] == list(BUILTIN_RIGS)


def test_a_rig_is_shown_as_json():
    shown = json.loads(output_of("show", "nova-carter", "--json"))
    assert [sensor["name"] for sensor in shown["sensors"]] == [s.name for s in load_rig("nova-carter").sensors]


@pytest.mark.parametrize("name", BUILTIN_RIGS)
def test_a_printed_rig_is_a_file_of_the_same_rig(name: str, tmp_path: Path):
    path = tmp_path / "copy.toml"
    path.write_text(output_of("show", name, "--toml"))
    assert load_rig(str(path)) == load_rig(name)


@pytest.mark.parametrize("name", BUILTIN_RIGS)
def test_every_built_in_rig_passes_the_check(name: str):
    checked = json.loads(output_of("check", name, "--json"))
    assert list(checked["rendered"]) == [camera.name for camera in load_rig(name).cameras]


def test_a_rig_for_another_control_rate_is_refused():
    with pytest.raises(InvalidRig, match="does not fit a control rate of 25 Hz"):
        output_of("check", "nova-carter", "--control-hz", "25")
