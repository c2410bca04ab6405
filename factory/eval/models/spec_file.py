"""The file of specs on disk: JSON with a format version. Reads and writes one file."""

from __future__ import annotations

import json
from pathlib import Path

from pydantic import ValidationError

from factory.eval.models.spec import SPECS_FORMAT, SpecSet
from schemas.errors import UsageError, WorldError

__all__ = ["read_specs", "write_specs"]

_MOST_BYTES = 1 << 30


def read_specs(path: Path) -> SpecSet:
    """Reads a file of specs.

    Raises:
        UsageError: there is no such file, it is no file of specs, or of a newer format.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise UsageError(f"{path} is larger than {_MOST_BYTES >> 20} MiB, so it is not a specs file")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read ({error}); create a specs file with `factory eval specs`") from error
    _refuse_newer(path, text)
    try:
        return SpecSet.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the beginning"
        raise UsageError(f"{path} is not a valid specs file: at {where}: {first['msg']}") from error


def write_specs(specs: SpecSet, path: Path) -> None:
    """Writes a file of specs, whole or not at all.

    Raises:
        WorldError: it cannot be written.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_text(specs.model_dump_json(indent=1) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise WorldError(f"cannot write {path}: {error.strerror}") from error


def _refuse_newer(path: Path, text: str) -> None:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return
    version = found.get("format") if isinstance(found, dict) else None
    if isinstance(version, int) and version > SPECS_FORMAT:
        raise UsageError(
            f"{path} has format {version}, this software reads formats up to {SPECS_FORMAT}: upgrade minivla-factory"
        )
