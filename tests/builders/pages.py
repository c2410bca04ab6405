"""Parses the documents of the repository: links, anchors, code blocks and command lines."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click

from factory.cli.groups import DefaultGroup
from factory.cli.main import cli

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "deploy").rglob("*.md")])
_BLOCK = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"(?<!\\)\]\(([^)\s]+)\)")


def blocks(page: Path, kind: str = "") -> list[str]:
    """Returns the fenced blocks of one language; `""` selects the blocks without a language, which contain commands."""
    return [text for found, text in _BLOCK.findall(page.read_text(encoding="utf-8")) if found == kind]


def prose(page: Path) -> str:
    """Returns the text without fenced blocks."""
    return _BLOCK.sub("", page.read_text(encoding="utf-8"))


def links_of(page: Path) -> list[str]:
    """Returns the destinations of all links and pictures, except web and mail addresses."""
    found = _LINK.findall(re.sub(r"`[^`\n]*`", "", prose(page)))
    return [link for link in found if not link.startswith(("http://", "https://", "mailto:"))]


def anchors_of(page: Path) -> set[str]:
    """Returns the anchors of all headings in GitHub's form."""
    titles = re.findall(r"^#{1,6} +(.*?) *$", prose(page), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", re.sub(r"\[(.*?)\]\(.*?\)", r"\1", title).lower()).replace(" ", "-") for title in titles
    }


def factory_lines(page: Path) -> Iterator[list[str]]:
    """Yields the arguments after `factory` of every command line in the blocks of a page."""
    for line in _lines(page):
        for command in line.split(";"):
            words = shlex.split(re.sub(r"\[(-[^\]]*)\]", r"\1", command), comments=True)
            while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
                words = words[1:]
            if words and words[0] == "factory":
                yield words[1:]


def make_lines(page: Path) -> set[str]:
    """Returns the targets of all `make` commands in the code blocks and inline code of a page."""
    code = "\n".join([*_lines(page), *re.findall(r"`([^`\n]*)`", prose(page))])
    return set(re.findall(r"^make ([a-z][a-z-]*)", code, re.MULTILINE))


def _lines(page: Path) -> Iterator[str]:
    for block in blocks(page):
        yield from re.sub(r"\\\n\s*", "", block).splitlines()


def parse_line(words: list[str]) -> None:
    """Parses every option and argument of one command line with the real command; runs nothing.

    Raises:
        click.UsageError: the command line is not valid.
    """
    verb: click.Command = cli
    context = click.Context(cli)
    while isinstance(verb, click.Group) and (found := verb.get_command(context, words[0])) is not None:
        verb, words = found, words[1:]
    if isinstance(verb, DefaultGroup):
        verb = verb.default
    assert not isinstance(verb, click.Group), words
    verb.make_context(verb.name, words)
