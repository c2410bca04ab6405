"""Reads TOML files into plain data, and lists the mistakes of their content by key and line. Defines no model."""

from __future__ import annotations

import difflib
import re
import tomllib
import typing
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from schemas.errors import FactoryError, Findings, UsageError
from schemas.support.foreign import PARSER_ERRORS, path_trouble
from schemas.support.suggest import did_you_mean

_MOST_BYTES = 4 << 20
_DEEP_KEY = re.compile(r"^[ \t]*\[{0,2}(?:[ \t]*[\w-]+[ \t]*\.){1000}", re.ASCII | re.MULTILINE)
"""Matches a key with more than 1000 parts, which no valid file has. The time in which `tomllib` reads a key grows with
the square of the number of its parts."""
_SYNTAX = re.compile(r"\(at line (\d+), column (\d+)\)")
_HEADER = re.compile(r"[ \t]*(\[\[?)([^\[\]#]+)\]", re.ASCII)
_KEY = re.compile(r"[ \t]*([\w.\"'-]+)[ \t]*=", re.ASCII)
_LINE_CHARS = 60
_EXPECTED = {
    "dict_type": "expected a table such as `{KEY}{{ name = 1.0 }}`",
    "tuple_type": 'expected a list such as `{KEY}["chair"]`',
    "list_type": 'expected a list such as `{KEY}["chair"]`',
    "model_type": "expected a table with its keys",
}
"""Messages for types of pydantic errors whose message names no TOML value."""

Location = tuple[str | int, ...]
"""Keys and positions of lists from the root of a file to a value."""


def read_toml(path: Path, noun: str, refusal: type[Findings]) -> dict[str, Any]:
    """Returns the content of a TOML file of at most 4 MiB.

    Args:
        path: existing file.
        noun: content of the file for messages, such as `plan`.
        refusal: class of the error.

    Raises:
        Findings: the file cannot be read as TOML; the class of the error is `refusal`.
    """
    text = ""
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
        raise refusal(f"{path} {what}", [_describe_syntax(str(error), text)]) from error


def mistakes_of(error: ValidationError, text: str = "") -> list[str]:
    """Returns one sentence for each mistake, with its key.

    Args:
        error: error of a model.
        text: content of the TOML file, for the lines of the keys.
    """
    return describe_mistakes(error.errors(), text)


def describe_mistakes(items: Sequence[Any], text: str = "", model: type[BaseModel] | None = None) -> list[str]:
    """Returns one sentence for each error of pydantic, with its key and line.

    Args:
        items: errors, as `ValidationError.errors` returns them.
        text: content of the TOML file, for the lines of the keys.
        model: model of the file, for suggestions of keys.
    """
    deeper = {item["loc"][:1] for item in items if len(item["loc"]) > 1}
    lines = _lines_of_keys(text)
    sentences: list[str] = []
    for item in sorted(items, key=lambda item: _line_of(item["loc"], lines) or 0):
        if item["type"] == "too_short" and item["loc"] in deeper:
            continue  # the list is too short only because its items are invalid
        sentences += _sentences_of(item, lines, model)
    return sentences


def _sentences_of(item: Any, lines: Mapping[Location, int], model: type[BaseModel] | None) -> list[str]:
    key, location = "", tuple(part for part in item["loc"] if part != "[key]")
    for part in location:
        key += f"[{part}]" if isinstance(part, int) else f".{part}" if key else str(part)
    message = str(item["msg"]).removeprefix("Value error, ")
    if not key:
        return message.splitlines()  # a validator of a whole file raises one error with a line for each mistake
    line = _line_of(location, lines)
    if item["type"] == "union_tag_invalid":
        return [f"{key}: {_unknown_tag(item['ctx'])}"]
    message = message.replace("\n", "; ")
    name = str(location[-1])
    if item["type"] in _EXPECTED:
        message = _EXPECTED[item["type"]].format(KEY=f"{name} = ")
    given = item["input"]
    found = [f"found {given!r}"] if isinstance(given, str | int | float | bool) else []
    found += [f"line {line}"] if line is not None else []
    shown = f" ({', '.join(found)})" if found else ""
    meant = ""
    if item["type"] == "extra_forbidden":
        message, meant = "no such key", "" if model is None else _meant_key(model, location)
    elif item["type"] == "enum" and isinstance(given, str):
        meant = did_you_mean(given, re.findall("'([^']+)'", str(item["ctx"]["expected"])))
    return [f"{key}: {message}{shown}{meant}"]


def _line_of(location: Location, lines: Mapping[Location, int]) -> int | None:
    """Returns the line of a key, or of the table that lacks it; `None` if the text contains neither."""
    return next((lines[location[:end]] for end in range(len(location), 0, -1) if location[:end] in lines), None)


def _meant_key(model: type[BaseModel], location: Location) -> str:
    """Returns which key was probably meant by an unknown key, as the end of a sentence; empty if none is similar."""
    tables = {"": model, **dict(_tables_of(model))}
    table = ".".join(part for part in location[:-1] if isinstance(part, str))
    name, here = str(location[-1]), _keys_of(tables[table]) if table in tables else set[str]()
    if meant := did_you_mean(name, here):
        return meant
    by_key = {key: table for table, owner in reversed(tables.items()) for key in _keys_of(owner)}
    near = difflib.get_close_matches(name, by_key, n=1, cutoff=0.75)
    if not near:
        return ""
    where = f"in the table `{by_key[near[0]]}`" if by_key[near[0]] else "at the top of the file, before the first table"
    return f"; `{near[0]}` belongs {where}"


def _keys_of(model: type[BaseModel]) -> set[str]:
    return set(model.model_fields)


def _tables_of(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Yields the path and the model of each table within the file of a model, e.g. `scenes` or `camera`."""
    for name, field in model.model_fields.items():
        for inner in models_in(field.annotation):
            yield f"{prefix}{name}", inner
            yield from _tables_of(inner, f"{prefix}{name}.")


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yields the models in a type such as `tuple[ScenePlan, ...]` or `RigData | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in typing.get_args(annotation):
        yield from models_in(part)


def _lines_of_keys(text: str) -> dict[Location, int]:
    """Returns the line of each table and key of a TOML text, from 1. A key within an inline table is not listed."""
    lines: dict[Location, int] = {}
    counts: Counter[tuple[str, ...]] = Counter()
    table: Location = ()
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            names = tuple(part.strip(" \t\"'") for part in header[2].split("."))
            counts[names] += header[1] == "[["
            table = ()
            for end, name in enumerate(names, 1):
                table = (*table, name, counts[names[:end]] - 1) if counts[names[:end]] else (*table, name)
            lines.setdefault(table, number)
        elif key := _KEY.match(line):
            parts = tuple(part.strip("\"'") for part in key[1].split("."))
            lines.setdefault((*table, *parts), number)
    return lines


def _describe_syntax(message: str, text: str) -> str:
    """Returns the message of a syntax error, with the line, a mark below its column, and the probable cause."""
    found = _SYNTAX.search(message)
    lines = text.splitlines()
    if found is None or not 1 <= int(found[1]) <= len(lines):
        return message
    number, column = int(found[1]), int(found[2])
    line = lines[number - 1]
    _, _, value = line.partition("=")
    value = value.strip()
    cause = ""
    if "Illegal character '\\n'" in message or (value[:1] in ("'", '"') and value.count(value[0]) == 1):
        cause = "; a quote is missing at the end of the text"
    elif message.startswith("Invalid value") and value[:1].isalpha():
        cause = f'; a text needs quotes: {line.partition("=")[0].strip()} = "{value[:_LINE_CHARS]}"'
    mark = f"\n      {line}\n      {' ' * (column - 1)}^" if len(line) <= _LINE_CHARS else ""
    return f"line {number}: {message[: found.start()].strip()}{cause}{mark}"


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
