"""What docs/scenes/own.md tells to type is understood: its commands, rules, row of targets and plan."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
import yaml

from coordinator.expansion.file import parse_plan
from factory.cli.common.groups import DefaultGroup
from factory.cli.main import cli
from factory.scenes.rules import load_rules
from factory.scenes.targets.target_list import TargetEntry

PAGE = Path(__file__).parents[4] / "docs" / "scenes" / "own.md"
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def blocks(kind: str) -> list[str]:
    return [text for found, text in BLOCKS if found == kind]


def commands() -> Iterator[list[str]]:
    for line in "".join(blocks("")).splitlines():
        yield shlex.split(line, comments=True)


@pytest.mark.parametrize("words", list(commands()), ids=" ".join)
def test_a_command_of_the_page_is_understood(words: list[str]) -> None:
    assert words[0] == "factory"
    words = words[1:]
    verb: click.Command = cli
    context = click.Context(cli)
    while isinstance(verb, click.Group) and (found := verb.get_command(context, words[0])) is not None:
        verb, words = found, words[1:]
    if isinstance(verb, DefaultGroup):
        verb = verb.default
    assert not isinstance(verb, click.Group)
    verb.make_context(verb.name, words)


def test_rules_row_and_plan_of_the_page_are_understood(tmp_path: Path) -> None:
    rules, row = blocks("yaml")
    path = tmp_path / "rules.yaml"
    path.write_text(rules)
    found = load_rules(path).match("aws_robomaker_warehouse_Bucket_01_020")
    assert found is not None
    assert found.category == "bucket"
    (entry,) = (TargetEntry.model_validate(one) for one in yaml.safe_load(row))
    (plan,) = blocks("toml")
    (scene,) = parse_plan({"name": "aws", **tomllib.loads(plan)}, "own.md").scenes
    assert {found.category, entry.category} <= set(scene.categories.seen)
