"""All formats by name, loaded when used. A new format is one file and one line here."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

from factory.export.base import Exporter
from schemas.errors import UsageError
from schemas.support.extras import require_package
from schemas.support.suggest import did_you_mean

__all__ = ["EXPORTERS", "AnyExporter", "check_format", "find_exporter", "require_packages"]

AnyExporter = Exporter[Any, Any]

EXPORTERS: Mapping[str, str] = MappingProxyType(
    {
        "paper": "factory.export.paper:PaperExporter",
        "lerobot": "factory.export.lerobot.v30:LeRobotExporter",
        "lerobot-v2.1": "factory.export.lerobot.v21:LeRobotV21Exporter",
        "webdataset": "factory.export.webdataset:WebdatasetExporter",
        "mcap": "factory.export.mcap.exporter:McapExporter",
        "gnm": "factory.export.gnm:GnmExporter",
        "vlnce": "factory.export.vlnce.exporter:VlnceExporter",
    }
)
"""Name -> module and class."""


_MADE_ELSEWHERE: Mapping[str, str] = MappingProxyType(
    {"rlds": "TFDS builds it from the dataset; builder and recipe are in docs/formats/rlds/README.md"}
)
"""Formats that other tools write, and how."""


def check_format(name: str) -> None:
    """Makes sure that a format is called that, without loading it.

    Raises:
        UsageError: there is no such format.
    """
    if name in EXPORTERS:
        return
    if name.lower() in _MADE_ELSEWHERE:
        raise UsageError(f"`factory export` does not write {name.lower()}: {_MADE_ELSEWHERE[name.lower()]}")
    raise UsageError(f"no format {name!r}; there are {', '.join(EXPORTERS)}{did_you_mean(name, EXPORTERS)}")


@cache
def find_exporter(name: str) -> AnyExporter:
    """Returns the exporter of a format; heavy packages are imported when it writes.

    Raises:
        UsageError: there is no such format.
    """
    check_format(name)
    module, _, kind = EXPORTERS[name].partition(":")
    exporter: AnyExporter = getattr(importlib.import_module(module), kind)()
    return exporter


def require_packages(exporter: AnyExporter) -> None:
    """Makes sure that a format's packages are installed.

    Raises:
        UsageError: one is not; the message names the command that installs it.
    """
    for module in exporter.requires:
        require_package(module, f"format {exporter.name}")
