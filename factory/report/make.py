"""Makes a report: gathers, draws, compares, writes. The one module that knows all others of the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from factory.report.comparison.rows import compare
from factory.report.data import ReportInput
from factory.report.drawing.figure import Drawer, Exhibit
from factory.report.figures.registry import DRAWERS
from factory.report.folder import FIGURES, PAGE_FILE, Summary, require_usable, write_files
from factory.report.gather import gather
from factory.report.page.document import write_page
from schemas.storage.place import Place

__all__ = ["make_report", "render_report"]

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
        root: of the dataset; only read.
        out: a folder that is empty, absent or holds an earlier report.
        force: whether to write into a folder that holds something else; nothing of it is deleted.
        on_progress: called with what is being done, how many are done and their total.
        compare_paper: see `measure_dataset`.

    Raises:
        UsageError: `out` is no place for a report.
        WorldError: there is no dataset, or the disk is full.
        ArchiveCorrupt: the dataset's description or table of episodes cannot be read at all.
    """
    require_usable(out, force)
    material = gather(root, lambda done, total: on_progress("episodes", done, total), compare_paper=compare_paper)
    files, summary = render_report(material, lambda done, total: on_progress("figures", done, total))
    write_files(out, files, summary)
    return summary


def render_report(
    material: ReportInput,
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
    drawers: Sequence[Drawer] = DRAWERS,
) -> tuple[dict[str, bytes], Summary]:
    """Returns the files of a report by name, and its summary; the same material gives the same bytes.

    Args:
        material: what the dataset holds.
        on_progress: called with the number of figures drawn and their total.
        drawers: which figures, in the order of the page.
    """
    exhibits: list[Exhibit] = []
    for done, drawer in enumerate(drawers, 1):
        exhibits.append(drawer(material))
        on_progress(done, len(drawers))
    comparisons = compare(material)
    files = {PAGE_FILE: write_page(material, exhibits, comparisons).encode()}
    for exhibit in exhibits:
        for panel in exhibit.panels:
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
