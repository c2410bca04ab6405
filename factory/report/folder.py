"""Writes the files of a report to a folder that is empty or contains an earlier report, which it replaces.

Does not delete files that no report wrote.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from pydantic import ValidationError

from factory.report.comparison.model import PaperComparison
from factory.stats.model import Remark
from schemas.base import Model
from schemas.errors import UsageError, WorldError
from schemas.storage.dataset_files import META_FILE

MARKER_FILE, PAGE_FILE, FIGURES = "report.json", "report.html", "figures"
_FORMAT = 1


class Summary(Model):
    """Content of `report.json`, the machine-readable report. The file marks the folder of a report."""

    report_format: int = _FORMAT
    run: str
    plan_digest: str
    dataset_digest: str | None
    episodes: int
    planned: int
    complete: bool
    remarks: tuple[Remark, ...]
    comparisons: tuple[PaperComparison, ...]
    files: tuple[str, ...]
    """Relative paths of all other files of the report."""


def require_usable(out: Path, force: bool) -> None:
    """Checks that a report can be written to `out`.

    Raises:
        UsageError: `out` is a file, is in a dataset, or contains other files and `force` is false.
    """
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is a file; give a folder with -o")
    inside = out.resolve()
    if any((folder / META_FILE).exists() for folder in (inside, *inside.parents)):
        raise UsageError(f"{out} is inside a dataset, which must not contain other files; choose another -o")
    if not force and out.is_dir() and any(out.iterdir()) and _read_marker(out) is None:
        raise UsageError(
            f"{out} is not empty and not a report; choose an empty folder with -o, or write into it with --force"
        )


def write_files(out: Path, files: Mapping[str, bytes], summary: Summary) -> None:
    """Writes a report to a folder and replaces each file atomically; deletes files that only the earlier report had.

    Raises:
        WorldError: the disk is full or not writable.
    """
    try:
        earlier = _read_marker(out)
        (out / FIGURES).mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            _replace(out / name, data)
        for name in sorted(set(earlier.files if earlier else ()) - files.keys()):
            if _is_ours(name):
                (out / name).unlink(missing_ok=True)
        _replace(out / MARKER_FILE, (summary.model_dump_json(indent=1) + "\n").encode())
    except OSError as error:
        remedy = "free space or choose another -o"
        raise WorldError(f"cannot write the report to {out} ({error.strerror}); {remedy}") from error


def _replace(path: Path, data: bytes) -> None:
    beside = path.with_name(f".{path.name}.part")
    beside.write_bytes(data)
    beside.replace(path)


def _read_marker(out: Path) -> Summary | None:
    try:
        return Summary.model_validate_json((out / MARKER_FILE).read_bytes())
    except (OSError, ValidationError):
        return None


def _is_ours(name: str) -> bool:
    """Returns whether a name is valid for a report file; a user can have edited the names in `report.json`."""
    path = PurePosixPath(name)
    return name == PAGE_FILE or (path.parts[:-1] == (FIGURES,) and path.suffix in {".svg", ".png"})
