"""Commands, rules, target row and plan of docs/scenes/own.md are valid."""

from __future__ import annotations

import shlex
import tomllib
from pathlib import Path

import pytest
import yaml

from coordinator.expansion.plan_file import parse_plan
from factory.scenes.rules import load_rules
from factory.scenes.targets.target_list import TargetEntry, load_target_list
from tests.builders.pages import ROOT, blocks, parse_line

PAGE = ROOT / "docs" / "scenes" / "own.md"
COMMANDS = [shlex.split(line, comments=True) for line in "".join(blocks(PAGE)).splitlines()]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_a_command_of_the_page_is_valid(words: list[str]) -> None:
    assert words[0] == "factory"
    parse_line(words[1:])


def test_rules_target_row_and_plan_of_the_page_are_valid(tmp_path: Path) -> None:
    rules, row, boxes = blocks(PAGE, "yaml")
    path = tmp_path / "rules.yaml"
    path.write_text(rules)
    found = load_rules(path).match("aws_robomaker_warehouse_Bucket_01_020")
    assert found is not None
    assert found.category == "bucket"
    (entry,) = (TargetEntry.model_validate(one) for one in yaml.safe_load(row))
    path.write_text(boxes)
    assert all(target.box_m for target in load_target_list(path).targets)
    (plan,) = blocks(PAGE, "toml")
    (scene,) = parse_plan({"name": "aws", **tomllib.loads(plan)}, "own.md").scenes
    assert {found.category, entry.category} <= set(scene.categories.seen)
