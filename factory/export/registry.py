"""Registry of export formats; modules are imported on first use. A new format needs one module,
one line here, and its options in `factory.export.options`."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING

from schemas.errors import UsageError
from schemas.support.extras import require_package
from schemas.support.suggest import did_you_mean

if TYPE_CHECKING:
    from factory.export.base import AnyExporter

EXPORTERS: Mapping[str, str] = MappingProxyType(
    {
        "paper": "factory.export.paper:PaperExporter",
        "lerobot": "factory.export.lerobot.v30:LeRobotExporter",
        "lerobot-v2.1": "factory.export.lerobot.v21:LeRobotV21Exporter",
        "webdataset": "factory.export.webdataset:WebdatasetExporter",
        "mcap": "factory.export.mcap.exporter:McapExporter",
        "gnm": "factory.export.gnm:GnmExporter",
        "vlnce": "factory.export.vlnce.exporter:VlnceExporter",
        "coco": "factory.export.coco:CocoExporter",
        "navdp": "factory.export.internnav:NavDpExporter",
        "internnav": "factory.export.internnav:InternNavExporter",
        "rlds": "factory.export.rlds:RldsExporter",
        "robomimic": "factory.export.robomimic:RobomimicExporter",
    }
)
"""Name of the format -> module and class."""


def check_format(name: str) -> None:
    """Validates the name of a format without importing it.

    Raises:
        UsageError: the format is unknown.
    """
    if name not in EXPORTERS:
        valid = ", ".join(EXPORTERS)
        raise UsageError(f"unknown format {name!r}; valid formats: {valid}{did_you_mean(name, EXPORTERS)}")


@cache
def find_exporter(name: str) -> AnyExporter:
    """Returns the exporter of a format. The exporter imports large packages when it writes.

    Raises:
        UsageError: the format is unknown.
    """
    check_format(name)
    module, _, kind = EXPORTERS[name].partition(":")
    exporter: AnyExporter = getattr(importlib.import_module(module), kind)()
    return exporter


def require_rig_support(exporter: AnyExporter) -> None:
    """Checks that a format can contain the sensors of a rig.

    Raises:
        UsageError: it cannot; the message lists the formats that can.
    """
    if not exporter.takes_rig:
        able = ", ".join(name for name in EXPORTERS if find_exporter(name).takes_rig)
        raise UsageError(f"format {exporter.name} does not contain sensors of a rig; formats that do: {able}")


def require_packages(exporter: AnyExporter) -> None:
    """Checks that the packages of a format are installed.

    Raises:
        UsageError: a package is missing; the message contains the command that installs it.
    """
    for module in exporter.requires:
        require_package(module, f"format {exporter.name}")
