"""The page: one HTML document that holds its style, drawings and pictures, asks nothing of a network. Pure text.

Everything that comes from the dataset is escaped; a content security policy forbids scripts and requests.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources

from PIL import Image

from factory.report.comparison import Comparison
from factory.report.exhibit import Exhibit
from factory.report.exhibits.samples import outlined
from factory.report.exhibits.words import DASH, name, number, percent
from factory.report.material import Material, Sample
from factory.report.page_tables import prose, write_comparisons, write_table
from factory.report.palette import css_variables, with_variables
from factory.stats import paper
from factory.stats.model import Statistics

__all__ = ["write_page"]

_SAMPLE_PX = 360
_JPEG_QUALITY = 84
_ABOUT_PAPER = (
    "The paper is MiniVLA-Nav v1 (1174 episodes). It prints no start distances: where a reason needs one, it is "
    "TL + NE, which holds for straight drives. A difference needs a reason from 5 % in lengths and steps, 5 mm in "
    "NE (1 mm in its spread) and 2 percentage points in shares on."
)
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def write_page(material: Material, exhibits: Sequence[Exhibit], comparisons: Sequence[Comparison]) -> str:
    """Returns the document.

    Args:
        material: what the dataset holds.
        exhibits: in the order of the page.
        comparisons: with the paper.
    """
    title = f"{material.meta.run}: dataset report"
    parts = (
        _header(material),
        _remarks(material.statistics),
        _overview(material, comparisons),
        *(_section(place, exhibit, material, comparisons) for place, exhibit in enumerate(exhibits, 1)),
        _method(material),
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>\n{_style()}</style>\n</head>\n<body>\n"
        f"{_contents(exhibits)}\n<main>\n" + "\n".join(part for part in parts if part) + "\n</main>\n</body>\n</html>\n"
    )


def _style() -> str:
    own = resources.files("factory.report").joinpath("page.css").read_text(encoding="utf-8")
    light, dark = css_variables(dark=False), css_variables(dark=True)
    return f":root {{ {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n{own}"


def _contents(exhibits: Sequence[Exhibit]) -> str:
    links = [("overview", "Overview"), *((exhibit.name, exhibit.title) for exhibit in exhibits), ("method", "Method")]
    items = "".join(f'<li><a href="#{anchor}">{escape(text)}</a></li>' for anchor, text in links)
    return f'<nav aria-label="Contents"><details open><summary>Contents</summary><ol>{items}</ol></details></nav>'


def _header(material: Material) -> str:
    found, meta = material.statistics, material.meta
    state = "complete" if found.complete else f"{found.episodes} of {found.planned} planned episodes"
    facts = (
        f"{found.episodes} episodes",
        f"{len(material.scenes)} scene{'s' if len(material.scenes) > 1 else ''}",
        f"{name(found.expert)} expert",
        f"seed {meta.seed}",
        state,
    )
    digest = f'<p class="digest">dataset digest <code>{meta.dataset_digest}</code></p>' if meta.dataset_digest else ""
    badges = "".join(f"<li>{escape(fact)}</li>" for fact in facts)
    return (
        f'<header><p class="kicker">Dataset report</p><h1>{escape(meta.run)}</h1>'
        f'<ul class="badges">{badges}</ul>{digest}</header>'
    )


def _remarks(statistics: Statistics) -> str:
    if not statistics.remarks:
        return ""
    items = "".join(
        f'<li class="{"damage" if remark.is_damage else "note"}"><b>{"damage" if remark.is_damage else "note"}</b> '
        f"<code>{escape(remark.file)}</code> {escape(remark.text)}</li>"
        for remark in statistics.remarks
    )
    return f'<section class="remarks" id="left_out"><h2>What is left out, and why</h2><ul>{items}</ul></section>'


def _overview(material: Material, comparisons: Sequence[Comparison]) -> str:
    everything, fit = material.statistics.scenes[-1], material.statistics.correlation[0]
    said, beside = paper.OVERALL, material.statistics.beside_paper
    tiles = (
        ("episodes", str(everything.n), str(said.n)),
        ("success, of attempts", _success(material), "40–90 %"),
        ("navigation error", _with_unit(everything.ne_mean_m, 3, "m"), _with_unit(said.ne_mean_m, 3, "m")),
        ("trajectory length", _with_unit(everything.tl_mean_m, 2, "m"), _with_unit(said.tl_mean_m, 2, "m")),
        ("steps", number(everything.steps_mean, 1), number(said.steps_mean, 1)),
        ("r, distance and length", number(fit.r, 3), number(paper.FIT.r, 2)),
    )
    cards = "".join(
        f'<div class="tile"><dt>{escape(what)}</dt><dd><strong>{escape(ours)}</strong>'
        f"{f'<span>paper {escape(theirs)}</span>' if beside else ''}</dd></div>"
        for what, ours, theirs in tiles
    )
    verdict = _verdict(material, comparisons)
    return f'<section id="overview"><h2>Overview</h2><dl class="tiles">{cards}</dl>{verdict}</section>'


def _verdict(material: Material, comparisons: Sequence[Comparison]) -> str:
    if not material.statistics.episodes:
        return "<p>There are no episodes yet.</p>"
    means = "Means of NE, TL and steps; tables give the rest."
    if not comparisons:
        return f"<p>{means}</p>"
    away = [row for row in comparisons if row.reason]
    return (
        f"<p>{len(comparisons)} numbers of the paper can be asked of this dataset; {len(away)} differ noticeably, and "
        f"each says why beside its figure. {means}</p>"
    )


def _success(material: Material) -> str:
    rows = material.statistics.attempts
    return DASH if rows is None else percent(next(row for row in rows if row.group == "all").success.share, 0)


def _with_unit(value: float | None, digits: int, unit: str) -> str:
    return DASH if value is None else f"{number(value, digits)} {unit}"


def _section(place: int, exhibit: Exhibit, material: Material, comparisons: Sequence[Comparison]) -> str:
    beside = write_comparisons([row for row in comparisons if row.exhibit == exhibit.name])
    tables = "".join(write_table(table) for table in exhibit.tables)
    if exhibit.name == "samples":
        figure = _samples(material.drives.samples)
    else:
        figure = "".join(_inline(panel.svg, panel.alt) for panel in exhibit.panels)
    kind = "wide" if exhibit.wide or not (beside or tables) else "paired"
    caption = f"<figcaption><b>Figure {place}.</b> {prose(exhibit.caption)}</figcaption>"
    source = f' <span class="source">{escape(exhibit.source)}</span>' if material.statistics.beside_paper else ""
    return (
        f'<section id="{exhibit.name}" class="{kind}"><h2>{escape(exhibit.title)}{source}</h2><div class="body">'
        f'<figure><div class="panels">{figure}</div>{caption}</figure>'
        + (f'<div class="beside">{beside}{tables}</div>' if beside or tables else "")
        + "</div></section>"
    )


def _inline(svg: str, alt: str) -> str:
    label = f'<svg role="img" aria-label="{escape(alt)}" class="panel" '
    return with_variables(svg.replace("<svg ", label, 1))


def _samples(samples: Iterable[Sample]) -> str:
    return "".join(
        f'<div class="sample"><img alt="{escape(sample.row.instruction)}" src="{_jpeg(sample)}" width="{_SAMPLE_PX}" '
        f'height="{_SAMPLE_PX}"><p><em>{escape(sample.row.instruction)}</em><span>{escape(name(sample.row.scene))} · '
        f"{escape(name(sample.row.target_category))} · {sample.row.spawn_tier} · {escape(sample.row.episode_id)}, "
        f"step {sample.t}</span></p></div>"
        for sample in samples
    )


def _jpeg(sample: Sample) -> str:
    small = Image.fromarray(outlined(sample)).resize((_SAMPLE_PX, _SAMPLE_PX), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    small.save(buffer, "JPEG", quality=_JPEG_QUALITY)
    return f"data:image/jpeg;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"


def _method(material: Material) -> str:
    meta = material.meta
    software = ", ".join(f"{package} {version}" for package, version in sorted(meta.software.items()))
    renderers = "; ".join(meta.renderers) or "unknown"
    lines = (
        "All numbers come from the dataset's own tables (metadata.parquet, attempts.parquet) and equal those of "
        "`factory stats`. Tracks, actions and frames are read from the episodes.",
        "NE is the planar distance between base_link and the target's centroid at the end, TL the length driven; the "
        "distance of a start is planar too. Detour is TL less the straight line from start to end; the shortest way is "
        "measured along the floor to the success circle.",
        *((_ABOUT_PAPER,) if material.statistics.beside_paper else ()),
        f"Plan {meta.plan.name}, digest {meta.plan_digest[:16]}; rendered by {renderers}. Made with {software}.",
        "The same dataset gives the same page, byte for byte, with the same software.",
    )
    items = "".join(f"<p>{prose(line)}</p>" for line in lines)
    return f'<section id="method"><h2>Method</h2>{items}</section>'
