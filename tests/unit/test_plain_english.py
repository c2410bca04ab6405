"""Help texts and error messages contain none of the phrases that readers had to guess."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.unit.factory.cli.test_conventions import commands, options

ROOT = Path(__file__).parents[2]
PACKAGES = ("coordinator", "factory", "minivla", "schemas", "workers")
RIDDLES = re.compile(
    r"(?<!there )\b(is no (?!longer\b)|are none\b|is none\b|holds? (no|another|a|an)\b|"
    r"lies? (in|at|there|outside|inside|under)\b|"
    r"stands? (in|there|twice|where|above)\b|somebody|nobody|everybody|anew\b|asked for\b|is wanted\b|are wanted\b|"
    r"put right\b|(one|frames?|\d+) a (core|second|scene|host)\b|is gone\b|go on\b|goes on\b|left out\b)"
)
"""Phrases of another meaning than their words have in technical English."""


def raised_texts(path: Path) -> Iterator[tuple[int, str]]:
    """The constant parts of the messages that a module raises."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for part in ast.walk(node.exc):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield node.lineno, part.value


@pytest.mark.parametrize("package", PACKAGES)
def test_no_error_message_is_a_riddle(package: str) -> None:
    found = [
        (str(path.relative_to(ROOT)), line, text)
        for path in sorted((ROOT / package).rglob("*.py"))
        for line, text in raised_texts(path)
        if RIDDLES.search(text)
    ]
    assert found == []


def test_no_help_is_a_riddle() -> None:
    helps = [(path, command.help or "") for path, command in commands()]
    helps += [(f"{path} {option.opts[0]}", option.help or "") for path, option in options()]
    assert len(helps) > 150
    assert [(where, text) for where, text in helps if RIDDLES.search(text)] == []
