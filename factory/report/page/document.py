"""Builds the values of the template `report.html` of `factory.html`: texts, tables and drawings. Pure functions."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape

from PIL import Image

from factory.html import data_uri, render
from factory.html.measures import PLACES
from factory.html.palette import with_variables
from factory.report.comparison.paper_comparison import PaperComparison
from factory.report.data import FrameSample, ReportInput
from factory.report.drawing.canvas import Panel
from factory.report.drawing.figure import Figure
from factory.report.drawing.text import DASH, count, name, number, percent
from factory.report.figures.samples import outlined
from factory.report.page.tables import ComparisonCells, TableCells, format_comparison, format_table
from factory.stats import paper

_SAMPLE_PX = 360
_JPEG_QUALITY = 84
_ABOUT_PAPER = (
    "The paper is MiniVLA-Nav v1 (1174 episodes). It prints no start distances; explanations use TL + NE instead, "
    "which is exact for straight trajectories. The page explains each difference that exceeds a threshold: 5 % in "
    "lengths and steps (15 % for far starts, of which the paper has 14), 5 mm in NE (1 mm in its standard deviation), "
    "2 percentage points in shares, and 0.02 in r. The target is the paper's number plus or minus this threshold; for "
    "success rates, it is the published range. The verdict is inside if the whole 95 % interval is in the target, "
    "outside if no part of the interval is, and undecided otherwise. Intervals are Student's t for means, Wilson for "
    "shares, Fisher z for r; they do not include the paper's own uncertainty."
)


@dataclass(frozen=True)
class _Picture:
    """Sample frame of the page."""

    instruction: str
    facts: str
    source: str
    px: int = _SAMPLE_PX


@dataclass(frozen=True)
class _Section:
    """Section of the page with one figure."""

    name: str
    title: str
    source: str
    caption: str
    drawings: Sequence[str]
    """SVG elements, inserted without escaping."""
    samples: Sequence[_Picture]
    comparisons: Sequence[ComparisonCells]
    tables: Sequence[TableCells]
    is_wide: bool


def write_page(material: ReportInput, figures: Sequence[Figure], comparisons: Sequence[PaperComparison]) -> str:
    """Returns the HTML document.

    Args:
        material: input of the report.
        figures: figures in the order of the page.
        comparisons: comparisons with the paper.
    """
    meta = material.meta
    anchors = ((figure.name, figure.title) for figure in figures)
    return render(
        "report.html",
        title=f"{meta.run}: dataset report",
        kicker="Dataset report",
        run=meta.run,
        badges=list(_badges(material)),
        digest=("dataset digest", meta.dataset_digest) if meta.dataset_digest else None,
        contents=[("overview", "Overview"), *anchors, ("method", "Method")],
        remarks=material.statistics.remarks,
        tiles=_tiles(material),
        verdict=_verdict(material, comparisons),
        sections=[_section(figure, material, comparisons) for figure in figures],
        method=_method(material),
    )


def _badges(material: ReportInput) -> Iterator[str]:
    statistics = material.statistics
    yield count(statistics.episodes, "episode")
    yield count(len(material.scenes), "scene")
    yield f"{name(statistics.expert)} expert"
    yield f"seed {material.meta.seed}"
    yield "complete" if statistics.complete else f"{statistics.episodes} of {statistics.planned} planned episodes"


def _tiles(material: ReportInput) -> Sequence[tuple[str, str, str]]:
    """Returns measure, value of the dataset and, if compared, value of the paper."""
    everything, fit = material.statistics.scenes[-1], material.statistics.correlation[0]
    published, beside = paper.OVERALL, material.statistics.beside_paper
    tiles = (
        ("episodes", str(everything.n), str(published.n)),
        ("successful attempts", _success(material), "40–90 %"),
        ("navigation error", _with_unit(everything.ne_mean_m, 3, "m"), _with_unit(published.ne_mean_m, 3, "m")),
        ("trajectory length", _with_unit(everything.tl_mean_m, 2, "m"), _with_unit(published.tl_mean_m, 2, "m")),
        ("steps", number(everything.steps_mean, 1), number(published.steps_mean, 1)),
        ("r of distance and length", number(fit.r, 3), number(paper.FIT.r, 2)),
    )
    return [(what, ours, f"paper {theirs}" if beside else "") for what, ours, theirs in tiles]


def _verdict(material: ReportInput, comparisons: Sequence[PaperComparison]) -> str:
    if not material.statistics.episodes:
        return "The dataset has no episodes."
    means = "NE, TL and steps are means."
    if not comparisons:
        return means
    away = [row for row in comparisons if row.reason]
    verdicts = Counter(row.verdict for row in comparisons if row.verdict)
    return (
        f"{len(comparisons)} numbers of the paper are compared with this dataset; {len(away)} differ noticeably, for "
        f"reasons given next to the figures. {verdicts.total()} numbers have a 95 % interval: {verdicts['inside']} "
        f"intervals are inside the target range, {verdicts['outside']} are outside, and {verdicts['undecided']} "
        f"overlap its edge (undecided). {means}"
    )


def _success(material: ReportInput) -> str:
    rows = material.statistics.attempts
    return DASH if rows is None else percent(next(row for row in rows if row.group == "all").success.share, 0)


def _with_unit(value: float | None, digits: int, unit: str) -> str:
    return DASH if value is None else f"{number(value, digits)} {unit}"


def _section(figure: Figure, material: ReportInput, comparisons: Sequence[PaperComparison]) -> _Section:
    beside = [format_comparison(row) for row in comparisons if row.exhibit == figure.name]
    shows_samples = figure.name == "samples"
    return _Section(
        name=figure.name,
        title=figure.title,
        source=figure.source if material.statistics.beside_paper else "",
        caption=figure.caption,
        drawings=[] if shows_samples else [_inline(panel) for panel in figure.panels],
        samples=list(_pictures(material.drives.samples)) if shows_samples else [],
        comparisons=beside,
        tables=[format_table(table) for table in figure.tables],
        is_wide=figure.wide or not (beside or figure.tables),
    )


def _inline(panel: Panel) -> str:
    """Returns the SVG of a panel with the colours of the page; matplotlib has escaped its texts."""
    label = f'<svg role="img" aria-label="{escape(panel.alt)}" class="panel" '
    return with_variables(panel.svg.replace("<svg ", label, 1))


def _pictures(samples: Iterable[FrameSample]) -> Iterator[_Picture]:
    for sample in samples:
        row = sample.row
        what = (name(row.scene), name(row.target_category), row.spawn_tier, f"{row.episode_id}, step {sample.t}")
        yield _Picture(row.instruction, " · ".join(what), data_uri("image/jpeg", _jpeg(sample)))


def _jpeg(sample: FrameSample) -> bytes:
    small = Image.fromarray(outlined(sample)).resize((_SAMPLE_PX, _SAMPLE_PX), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=_JPEG_QUALITY)
    return buffer.getvalue()


def _method(material: ReportInput) -> Sequence[str]:
    meta = material.meta
    software = ", ".join(f"{package} {version}" for package, version in sorted(meta.software.items()))
    renderers = "; ".join(meta.renderers) or "unknown"
    return (
        "All numbers come from the dataset's own tables (metadata.parquet, attempts.parquet) and equal those of "
        "`factory stats`. Tracks, actions and frames are read from the episodes.",
        f"NE is the planar distance between base_link and the target's {PLACES[meta.plan.task.success]} at the end, TL "
        "the trajectory length; the start distance is planar too. Detour is TL minus the difference of start distance "
        "and NE; the shortest path is measured along the floor to the success region.",
        *((_ABOUT_PAPER,) if material.statistics.beside_paper else ()),
        f"Plan {meta.plan.name}, digest {meta.plan_digest[:16]}; rendered by {renderers}. Software: {software}.",
        "The page is reproducible: the same dataset and software give the same bytes.",
    )
