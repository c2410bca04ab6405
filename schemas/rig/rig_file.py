"""Loads rigs: built-in ones by name, others from TOML files. Errors name the key of every mistake. Writes nothing."""

from __future__ import annotations

import functools
from pathlib import Path

from pydantic import ValidationError

from schemas.builtin import BUILTIN_RIGS, DEFAULT_CONTROL_HZ
from schemas.errors import InvalidRig
from schemas.rig.rig import Rig
from schemas.support.toml_file import find_toml, mistakes_of, read_toml

_FOLDER = Path(__file__).parent / "builtin"


def load_rig(reference: str, control_hz: int | None = DEFAULT_CONTROL_HZ) -> Rig:
    """Returns a built-in rig by its name, or reads a TOML file.

    Args:
        reference: name of a built-in rig, or path of a file.
        control_hz: control rate that the rates of the sensors must divide, Hz; `None` checks no rates.

    Raises:
        UsageError: neither a built-in rig nor a file has that name.
        InvalidRig: the file has mistakes, or a rate does not divide the control rate; the error lists all of them.
    """
    path = find_toml(reference, "rig", _FOLDER, BUILTIN_RIGS)
    data = read_toml(path, "rig", InvalidRig)
    data.setdefault("name", path.stem)
    try:
        rig = Rig.model_validate(data)
    except ValidationError as error:
        raise InvalidRig(f"{path} is not a valid rig", mistakes_of(error)) from error
    if control_hz is not None:
        require_rates(rig, control_hz)
    return rig


@functools.cache
def paper_rig() -> Rig:
    """Returns the built-in rig `paper`, whose only sensor is the recorded camera of the default plan."""
    return load_rig("paper")


def require_rates(rig: Rig, control_hz: int) -> None:
    """Raises `InvalidRig` unless the rates of all sensors divide a control rate, Hz."""
    faults = rig.faults(control_hz)
    if faults:
        raise InvalidRig(f"rig {rig.name!r} does not fit a control rate of {control_hz} Hz", faults)
