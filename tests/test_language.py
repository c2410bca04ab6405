"""The language of documents, docstrings, messages and help: no figurative phrases and no former names."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.builders.pages import PAGES, ROOT

PACKAGES = ("schemas", "coordinator", "workers", "factory", "minivla", "tests", "docs", "deploy")
OTHER_SUFFIXES = ("c", "css", "html", "j2", "service", "sh", "toml", "yaml", "yml")
OTHER_FILES = ("Makefile", "pyproject.toml")
HISTORY = {ROOT / "CHANGELOG.md", *(ROOT / "docs" / "decisions").glob("*.md")}
"""Texts that are true at their date and keep the names of that date."""
LISTS = {Path(__file__)}
"""Tests that list phrases."""
BANNED_PHRASES = (
    *("somebody", "nobody", "anybody", "everybody", "whoever", "whomever"),
    *("is none of", "that is none", "what is no", "what there is", "what came of it", "comes of it"),
    *("what became of", "becomes of", "whatever came", "over and over", "for good", "in so many", "anew"),
    *("stand in", "stands in", "stands for", "stands on the", "stands above", "stands twice", "stands where"),
    *("lie in", "lies in", "lies at", "lies inside", "lies outside", "lies under", "lies where", "lies with"),
    *("Says whether", "Says what", "Says nothing", "Says no", "is said", "are said", "has nothing to say"),
    *("is told", "are told", "was told", "as told", "told by", "told apart", "told from", "tells apart"),
    *("at hand", "of its own", "of their own", "of ours", "at the wheel", "goes the whole way"),
    *("befalls", "befall", "befell", "mishap", "mishaps", "felt", "feels", "calm run", "calm one"),
    *("in the wild", "in the face of", "in words", "may have meant", "wish", "wishes", "speaks", "begun"),
    *("confess", "confesses", "bury", "buries", "grow up", "grows up", "living", "dawdles"),
    *("to be had", "cannot be had", "can be had", "is wanted", "are wanted", "asked for", "put right"),
    *("is gone", "go on", "goes on", "leave out", "leaves out", "left out", "leaving out", "in the hold", "is nothing"),
    *("outrank", "outranks", "vouch", "vouches", "twin", "law of motion", "laws of motion"),
    *("DESIGN ", "STYLE ", "notes/"),
)
"""Phrases without a technical meaning. They match as whole words, in this case or with a capital."""
BANNED_PATTERNS = (
    r"(?<![Tt]here )(?:is no(?= (?!longer\b))|are none\b)",
    r"holds? (?:no|another|an?)\b",
    r"(?:one|frames?|images?|requests?|[MGk]B|m?s|\d+) a (?:core|second|minute|hour|scene|host|frame|step)\b",
)
"""Regular expressions of phrases with the same fault."""
NAMES = (
    *("Seat", "Sheet", "Errand", "Parcel", "Insider", "Situation", "Relief", "Patient", "Lap", "Sighting", "Judgement"),
    *("errand", "errands", "parcel", "parcels", "nursery", "naked", "spell", "spells", "the party", "throttled"),
)
"""Former names of classes and parts; not banned in `HISTORY`."""
TEMPLATE_CODE = re.compile(r"\{[{%].*?[}%]\}")


def _pattern(phrases: tuple[str, ...], patterns: tuple[str, ...] = ()) -> re.Pattern[str]:
    words = sorted(set(phrases) | {phrase[0].upper() + phrase[1:] for phrase in phrases}, key=len)
    found = "|".join((*map(re.escape, reversed(words)), *patterns))
    return re.compile(rf"(?<![\w/.`\"'-])(?:{found})(?![\w-])")


BANNED = _pattern((*BANNED_PHRASES, *NAMES), BANNED_PATTERNS)
BANNED_IN_HISTORY = _pattern(BANNED_PHRASES, BANNED_PATTERNS)


def python_text(source: str) -> Iterator[tuple[int, str]]:
    """Yields line and text of docstrings, comments and strings of several words; fields of f-strings are code."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string


def text_of(path: Path) -> list[tuple[int, str]]:
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return list(python_text(source))
    return [(line, TEMPLATE_CODE.sub("", text)) for line, text in enumerate(source.splitlines(), 1)]


def files() -> list[Path]:
    found = [*PAGES, *(ROOT / name for name in OTHER_FILES)]
    for package in PACKAGES:
        for suffix in ("py", *OTHER_SUFFIXES):
            found += (ROOT / package).rglob(f"*.{suffix}")
    return sorted({path for path in (*found, *HISTORY) if path not in LISTS})


def hits(path: Path) -> list[str]:
    return [
        f"{path.relative_to(ROOT)}:{line}: {' '.join(text[max(0, hit.start() - 30) : hit.end() + 30].split())}"
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


def test_identifiers_and_code_are_not_text() -> None:
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
def test_a_banned_phrase_is_found_in_any_position(text: str) -> None:
    assert BANNED.search(text)


@pytest.mark.parametrize(
    "text",
    [
        *("a worksheet", "spelling", "the file `kitchen.usd`", "felting", "third-party code", "20 frames per second"),
        *("There is no scene", "it is no longer a scene"),
    ],
)
def test_parts_of_other_words_are_not_found(text: str) -> None:
    assert BANNED.search(text) is None
