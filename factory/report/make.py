"""Makes a report: reads the input, draws the figures, compares with the paper and writes the files.

The folder is empty or contains an earlier report, which is replaced. Files that no report wrote are not deleted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath

from pydantic import ValidationError

from factory.report.comparison.paper_comparison import PaperComparison
from factory.report.comparison.rows import compare
from factory.report.data import ReportInput
from factory.report.drawing.figure import DrawFunction, Figure
from factory.report.figures.registry import DRAW_FUNCTIONS
from factory.report.gather import gather
from factory.report.page.document import write_page
from factory.stats.statistics import Remark
from schemas.base import Model
from schemas.errors import UsageError, WorldError
from schemas.storage.dataset_files import META_FILE
from schemas.storage.place import Place

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


StepProgressCallback = Callable[[str, int, int], None]


def make_report(
    root: Place,
    out: Path,
    force: bool = False,
    on_progress: StepProgressCallback = lambda _what, _done, _all: None,
    compare_paper: bool | None = None,
) -> Summary:
    """Writes the report of a dataset: `report.html`, `figures/*.svg`, `figures/*.png` and `report.json`.

    Args:
        root: root of the dataset; read only.
        out: folder that is empty, does not exist or contains an earlier report.
        force: whether to write into a folder with other files, which are kept.
        on_progress: callback with the stage, the number of finished items and the total.
        compare_paper: see `measure_dataset`.

    Raises:
        UsageError: a report cannot be written to `out`.
        WorldError: the dataset does not exist, or the disk is full.
        ArchiveCorrupt: the metadata or the table of episodes cannot be read.
    """
    require_usable(out, force)
    material = gather(root, lambda done, total: on_progress("episodes", done, total), compare_paper=compare_paper)
    files, summary = render_report(material, lambda done, total: on_progress("figures", done, total))
    write_files(out, files, summary)
    return summary


def render_report(
    material: ReportInput,
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
    draw_functions: Sequence[DrawFunction] = DRAW_FUNCTIONS,
) -> tuple[dict[str, bytes], Summary]:
    """Returns the files of a report by name, and its summary. Equal input gives equal bytes.

    Args:
        material: input of the report.
        on_progress: callback with the number of figures drawn and the total.
        draw_functions: functions of the figures, in the order of the page.
    """
    # no file contains a date or a path, so reports of equal datasets can be compared by hash
    figures: list[Figure] = []
    for done, draw in enumerate(draw_functions, 1):
        figures.append(draw(material))
        on_progress(done, len(draw_functions))
    comparisons = compare(material)
    files = {PAGE_FILE: write_page(material, figures, comparisons).encode()}
    for figure in figures:
        for panel in figure.panels:
            files[f"{FIGURES}/{panel.name}.svg"] = panel.svg.encode()
            files[f"{FIGURES}/{panel.name}.png"] = panel.png
    statistics, meta = material.statistics, material.meta
    return files, Summary(
        run=meta.run,
        plan_digest=meta.plan_digest,
        dataset_digest=meta.dataset_digest,
        episodes=statistics.episodes,
        planned=statistics.planned,
        complete=statistics.complete,
        remarks=statistics.remarks,
        comparisons=comparisons,
        files=tuple(files),
    )
