"""The language of documents, docstrings, messages and help: no figurative phrases and no former names."""

from __future__ import annotations

import ast
import io
import re
import tokenize
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.builders.pages import PAGES, ROOT

PACKAGES = ("schemas", "coordinator", "workers", "factory", "minivla", "tests", "docs", "deploy")
OTHER_SUFFIXES = ("c", "css", "html", "j2", "service", "sh", "toml", "yaml", "yml")
OTHER_FILES = ("Makefile", "pyproject.toml")
HISTORY = {ROOT / "CHANGELOG.md"}
"""Texts that describe the state at their date and keep the names of that date."""
PHRASES = Path(__file__).with_name("banned_phrases.toml")
"""Phrases, regular expressions and former names, each with a replacement. Former names are not banned in `HISTORY`."""
LISTS = {Path(__file__), PHRASES}
"""Files that list phrases."""
TEMPLATE_CODE = re.compile(r"\{[{%].*?[}%]\}")


def _pattern(phrases: Iterable[str], patterns: Iterable[str]) -> re.Pattern[str]:
    words = sorted({form for phrase in phrases for form in (phrase, phrase[0].upper() + phrase[1:])}, key=len)
    found = "|".join((*map(re.escape, reversed(words)), *patterns))
    return re.compile(rf"(?<![\w/.`\"'-])(?:{found})(?![\w-])")


_LISTED = tomllib.loads(PHRASES.read_text(encoding="utf-8"))
BANNED = _pattern(_LISTED["phrases"] | _LISTED["names"], _LISTED["patterns"])
BANNED_IN_HISTORY = _pattern(_LISTED["phrases"], _LISTED["patterns"])


def replacement_of(hit: re.Match[str]) -> str:
    """Returns what to write instead of a phrase that was found."""
    found = hit.group()
    for part in ("phrases", "names"):
        for phrase, replacement in _LISTED[part].items():
            if found in (phrase, phrase[0].upper() + phrase[1:]):
                return str(replacement)
    patterns = _LISTED["patterns"].items()
    return next(str(text) for pattern, text in patterns if re.compile(pattern).match(hit.string, hit.start()))


def python_text(source: str) -> Iterator[tuple[int, str]]:
    """Yields line and text of docstrings, comments and strings of several words, without the fields of f-strings."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline) if "#" in source else ():
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def text_of(path: Path) -> list[tuple[int, str]]:
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return list(python_text(source))
    return [(line, TEMPLATE_CODE.sub("", text)) for line, text in enumerate(source.splitlines(), 1)]


@cache
def files() -> list[Path]:
    found = [*PAGES, *(ROOT / name for name in OTHER_FILES)]
    for package in PACKAGES:
        for suffix in ("py", *OTHER_SUFFIXES):
            found += (ROOT / package).rglob(f"*.{suffix}")
    return sorted({path for path in (*found, *HISTORY) if path not in LISTS})


def hits(path: Path) -> list[str]:
    return [
        f"{path.relative_to(ROOT)}:{line}: {' '.join(text[max(0, hit.start() - 30) : hit.end() + 30].split())}"
        f" (instead of {hit.group()!r}: {replacement_of(hit)})"
        for line, text in text_of(path)
        for hit in (BANNED_IN_HISTORY if path in HISTORY else BANNED).finditer(text)
    ]


@pytest.mark.parametrize("part", [*PACKAGES, "."])
def test_text_has_no_banned_phrase_and_no_former_name(part: str) -> None:
    parts = [path.relative_to(ROOT).parts for path in files()]
    chosen = [ROOT.joinpath(*names) for names in parts if (names[0] if len(names) > 1 else ".") == part]
    assert chosen
    found = [hit for path in chosen for hit in hits(path)]
    assert not found, "\n".join([f"{len(found)} phrases to rewrite:", *found])


def test_identifiers_and_code_are_not_checked() -> None:
    source = (
        "def stands_in(nobody):\n    return nobody  # a comment\n\n\n"
        "name = 'nobody', 'two words'\nvalue = f'a {stands_in(1)} b'\n"
    )
    assert {text for _, text in python_text(source)} == {"# a comment", "two words", "a ", " b"}


@pytest.mark.parametrize(
    "text",
    [
        *("what nobody expects", "Stands in for a part", "a Sheet of values", "20 frames a second", "it is no scene"),
        *("a category is left out", "the directory holds another plan"),
    ],
)
def test_a_banned_phrase_is_found_in_any_position_and_has_a_replacement(text: str) -> None:
    hit = BANNED.search(text)
    assert hit
    assert replacement_of(hit)


@pytest.mark.parametrize(
    "text",
    [
        *("a worksheet", "spelling", "the file `kitchen.usd`", "felting", "third-party code", "20 frames per second"),
        *("There is no scene", "it is no longer a scene"),
    ],
)
def test_parts_of_other_words_are_not_found(text: str) -> None:
    assert BANNED.search(text) is None
