"""Creates the command-line options of all formats from the fields of their option models."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any, Literal, TypeVar, get_args, get_origin

import click
from pydantic.fields import FieldInfo

from factory.export.registry import EXPORTERS, find_exporter

__all__ = ["format_options"]

Command = TypeVar("Command", bound=Callable[..., Any])


def format_options(command: Command) -> Command:
    """Adds one option for each field of each format's option model; the value is `None` if the option is not given."""
    for name, (info, formats) in reversed(_fields().items()):
        command = _option(name, info, formats)(command)
    return command


def _fields() -> dict[str, tuple[FieldInfo, list[str]]]:
    found: dict[str, tuple[FieldInfo, list[str]]] = {}
    for exporter in map(find_exporter, EXPORTERS):
        for name, info in exporter.options.model_fields.items():
            found.setdefault(name, (info, []))[1].append(exporter.name)
    return found


def _option(name: str, info: FieldInfo, formats: list[str]) -> Callable[[Command], Command]:
    flag = f"--{name.replace('_', '-')}"
    text = f"{info.description} [{', '.join(formats)}]"
    kind = _without_none(info.annotation)
    if kind is bool:
        return click.option(f"{flag}/--no-{flag[2:]}", name, default=None, help=text)
    if get_origin(kind) is Literal:
        return click.option(flag, name, type=click.Choice([str(value) for value in get_args(kind)]), help=text)
    if kind in (int, float, str):
        return click.option(flag, name, type=kind, metavar="N" if kind is int else None, help=text)
    raise TypeError(f"option {flag}: type {kind} is not supported on the command line")


def _without_none(annotation: Any) -> Any:
    if get_origin(annotation) is types.UnionType:
        return next(kind for kind in get_args(annotation) if kind is not type(None))
    return annotation
