"""Makes a report: reads the input, draws the figures, compares with the paper and writes the files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from factory.report.comparison.rows import compare
from factory.report.data import ReportInput
from factory.report.drawing.figure import DrawFunction, Figure
from factory.report.figures.registry import DRAW_FUNCTIONS
from factory.report.folder import FIGURES, PAGE_FILE, Summary, require_usable, write_files
from factory.report.gather import gather
from factory.report.page.document import write_page
from schemas.storage.place import Place

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
    found, meta = material.statistics, material.meta
    return files, Summary(
        run=meta.run,
        plan_digest=meta.plan_digest,
        dataset_digest=meta.dataset_digest,
        episodes=found.episodes,
        planned=found.planned,
        complete=found.complete,
        remarks=found.remarks,
        comparisons=comparisons,
        files=tuple(files),
    )
