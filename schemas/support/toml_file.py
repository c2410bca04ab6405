"""Reads TOML files into plain data, and lists the mistakes of their content by key. Uses no model."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from schemas.errors import FactoryError, Findings, UsageError
from schemas.support.foreign import PARSER_ERRORS, path_trouble
from schemas.support.suggest import did_you_mean

_MOST_BYTES = 4 << 20
_DEEP_KEY = re.compile(r"^[ \t]*\[{0,2}(?:[ \t]*[\w-]+[ \t]*\.){1000}", re.ASCII | re.MULTILINE)
"""Matches a key with more than 1000 parts, which no valid file has. The time in which `tomllib` reads a key grows with
the square of the number of its parts."""


def read_toml(path: Path, noun: str, refusal: type[Findings]) -> dict[str, Any]:
    """Returns the content of a TOML file of at most 4 MiB.

    Args:
        path: existing file.
        noun: content of the file for messages, such as `plan`.
        refusal: class of the error.

    Raises:
        Findings: the file cannot be read as TOML; the class of the error is `refusal`.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise refusal(f"{path} is not a {noun}", [f"it is larger than {_MOST_BYTES >> 20} MiB"])
        text = path.read_text(encoding="utf-8")
        if _DEEP_KEY.search(text):
            raise RecursionError
        return tomllib.loads(text)
    except FactoryError:
        raise
    except RecursionError as error:
        raise refusal(f"{path} is not a {noun}", ["its values are nested too deeply"]) from error
    except PARSER_ERRORS as error:
        what = "is not valid TOML" if path.suffix == ".toml" else f"is not a {noun}; {noun}s are TOML files"
        raise refusal(f"{path} {what}", [str(error)]) from error


def mistakes_of(error: ValidationError) -> list[str]:
    """Returns one sentence for each mistake, with its key."""
    items = error.errors()
    deeper = {item["loc"][:1] for item in items if len(item["loc"]) > 1}
    sentences = []
    for item in items:
        if item["type"] == "too_short" and item["loc"] in deeper:
            continue  # the list is too short only because its items are invalid
        sentences += _sentences_of(item)
    return sentences


def _sentences_of(item: Any) -> list[str]:
    key = ""
    for part in item["loc"]:
        if part != "[key]":
            key += f"[{part}]" if isinstance(part, int) else f".{part}" if key else str(part)
    message = str(item["msg"]).removeprefix("Value error, ")
    if not key:
        return message.splitlines()  # a validator of a whole file raises one error with a line for each mistake
    message = message.replace("\n", "; ")
    if item["type"] == "extra_forbidden":
        message = "no such key"
    if item["type"] == "union_tag_invalid":
        return [f"{key}: {_unknown_tag(item['ctx'])}"]
    given = item["input"]
    shown = f" (found {given!r})" if isinstance(given, str | int | float | bool) else ""
    return [f"{key}: {message}{shown}"]


def _unknown_tag(context: dict[str, str]) -> str:
    """Returns the message for a value of a discriminator that selects no model."""
    name, tag = context["discriminator"].strip("'"), context["tag"]
    known = [word.strip("' ") for word in context["expected_tags"].split(",")]
    return f"unknown {name} {tag!r}; valid: {', '.join(known)}{did_you_mean(tag, known)}"


def find_toml(reference: str, kind: str, folder: Path, builtin: Collection[str]) -> Path:
    """Returns the path of a built-in file or of a file of the user.

    Args:
        reference: name of a built-in file, or path.
        kind: what the file describes, for messages, such as `rig`.
        folder: folder of the built-in files.
        builtin: names of the built-in files, without suffix.

    Raises:
        UsageError: neither a built-in file nor a file has that name.
    """
    path = folder / f"{reference}.toml" if reference in builtin else Path(reference)
    trouble = path_trouble(reference)
    if trouble:
        raise UsageError(f"cannot read {kind} {reference[:80]!r}: {trouble}")
    if not path.is_file():
        known = f"the built-in {kind}s are {', '.join(builtin)}{did_you_mean(path.stem, builtin)}"
        what = "that is a directory; give a TOML file" if path.is_dir() else "no such file"
        raise UsageError(f"no {kind} {reference!r}: {what}; {known}")
    return path
