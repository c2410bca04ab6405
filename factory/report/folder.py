"""The folder a report is written to: ours or empty, else refused; a new report replaces an old one file by file.

Deletes nothing that an earlier report did not write.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from pydantic import ValidationError

from factory.report.comparison.model import PaperComparison
from factory.stats.model import Remark
from schemas.base import Model
from schemas.dataset_files import META_FILE
from schemas.errors import UsageError, WorldError

__all__ = ["FIGURES", "MARKER_FILE", "PAGE_FILE", "Summary", "require_usable", "write_files"]

MARKER_FILE, PAGE_FILE, FIGURES = "report.json", "report.html", "figures"
_FORMAT = 1


class Summary(Model):
    """`report.json`: what a report says, for programs; that it is there makes the folder a report's."""

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
    """All files of the report but this, below its folder."""


def require_usable(out: Path, force: bool) -> None:
    """Checks that a report may be written to `out`.

    Raises:
        UsageError: it is a file, lies in the dataset, or holds what no report wrote and `force` is off.
    """
    if out.exists() and not out.is_dir():
        raise UsageError(f"{out} is a file; -o wants a folder")
    inside = out.resolve()
    if any((folder / META_FILE).exists() for folder in (inside, *inside.parents)):
        raise UsageError(f"{out} lies in a dataset, which holds its own files only; give -o another folder")
    if not force and out.is_dir() and any(out.iterdir()) and _read_marker(out) is None:
        raise UsageError(f"{out} is not empty and holds no report; give an empty folder, or --force to write into it")


def write_files(out: Path, files: Mapping[str, bytes], summary: Summary) -> None:
    """Replaces the report in a folder: every file as a whole, what only the earlier report had is removed.

    Raises:
        WorldError: the disk is full or not ours to write to.
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
        remedy = "free space or give another -o"
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
    """Whether a name of a marker, which anybody may have edited, is one that a report gives."""
    path = PurePosixPath(name)
    return name == PAGE_FILE or (path.parts[:-1] == (FIGURES,) and path.suffix in {".svg", ".png"})
