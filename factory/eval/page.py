"""An evaluation as one self-contained HTML page: tables, rates with intervals, videos of failures. Pure text."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape

from factory.eval.estimate import Estimate
from factory.eval.phrases import ablation_rows, deaf_policies, ends_of, faults_in_words
from factory.eval.result import EpisodeResult
from factory.eval.score import GROUPS, Evaluation, PolicyScores, Score, side_by_side
from factory.stats.model import Share

__all__ = ["Failure", "write_page"]

Failure = tuple[EpisodeResult, bytes]
"""A failed episode and its video."""

_HEAD = (
    "n",
    "success, %",
    "any instance, %",
    "SPL",
    "soft-SPL",
    "NE, m",
    "OP final",
    "OP closest",
    "OP normalised",
    "TL, m",
    "steps",
    "collision, %",
    "contact, %",
    "timeout, %",
    "policy failure, %",
)
_STYLE = """
:root { color-scheme: light; --ink: #1d2129; --dim: #5c6675; --line: #d9dee6; --mark: #1f5fbf; --zebra: #f6f8fb; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1280px; padding: 24px 20px 60px; font: 15px/1.45 system-ui, sans-serif;
  color: var(--ink); background: #fff; }
h1 { font-size: 24px; margin: 0 0 4px; } h2 { font-size: 18px; margin: 32px 0 8px; }
p, li { color: var(--dim); max-width: 90ch; margin: 4px 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; white-space: nowrap; border-bottom: 1px solid var(--ink); padding: 4px 10px; }
td { padding: 4px 10px; white-space: nowrap; border-bottom: 1px solid var(--line); }
tr:nth-child(even) td { background: var(--zebra); }
small { color: var(--dim); }
svg text { font: 12px system-ui, sans-serif; fill: var(--ink); }
.clips { display: grid; grid-template-columns: repeat(auto-fill, minmax(300px, 1fr)); gap: 16px; }
figure { margin: 0; border: 1px solid var(--line); border-radius: 6px; overflow: hidden; }
figure img { width: 100%; display: block; background: #eee; aspect-ratio: 2; }
figcaption { padding: 6px 10px 10px; font-size: 13px; color: var(--dim); overflow-wrap: anywhere; }
figcaption b { color: var(--ink); }
"""


def write_page(evaluation: Evaluation, failures: Mapping[str, Sequence[Failure]]) -> str:
    """Returns the page.

    Args:
        evaluation: all tables.
        failures: for each policy, the failures to show.
    """
    policies = evaluation.policies
    title = f"Evaluation on {escape(evaluation.run)}"
    parts = [
        f"<h1>{title}</h1>",
        f"<p>{evaluation.episodes} episodes: {escape(evaluation.source)}. Success is a stop within "
        f"{evaluation.success_radius_m:g} m of the named object. Rates with 95 % Wilson intervals, means with 95 % BCa "
        "bootstrap intervals. Oracle progress (OP) is the covered share of the start distance, at the end, at the "
        "closest point, and the latter with the success radius taken off.</p>",
        "" if evaluation.complete else "<p><b>Not complete:</b> some episodes have not been driven yet.</p>",
        "<ul>" + "".join(f"<li>{escape(remark)}</li>" for remark in evaluation.remarks) + "</ul>",
        "<h2>Success rate</h2>",
        _chart(policies),
        "<h2>All episodes</h2>",
        _table(("policy", *_HEAD), [(policy.policy, *_cells(policy.overall)) for policy in policies]),
        _notes(policies),
        *_groups(policies),
        _ablations(policies),
        *(_clips(policy, failures.get(policy.policy, ())) for policy in policies),
    ]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>\n'
        f"<body>\n{chr(10).join(part for part in parts if part)}\n</body></html>\n"
    )


def _chart(policies: Sequence[PolicyScores]) -> str:
    """Success rates as dots with whiskers: overall, then by split."""
    rows = [
        (f"{policy.policy}{' · ' + group.group if group.by == 'split' else ''}", group.success, group.by == "all")
        for policy in policies
        for group in (policy.overall, *(g for g in policy.groups if g.by == "split"))
    ]
    left, width, high = 330, 560, 20
    marks = [
        f'<line x1="{left + width * tick / 100}" y1="14" x2="{left + width * tick / 100}" y2="{20 + high * len(rows)}" '
        f'stroke="#d9dee6"/><text x="{left + width * tick / 100}" y="10" text-anchor="middle">{tick}</text>'
        for tick in range(0, 101, 20)
    ]
    for number, (name, share, is_all) in enumerate(rows):
        y = 30 + high * number
        weight = ' font-weight="600"' if is_all else ""
        marks.append(f'<text x="{left - 12}" y="{y + 4}" text-anchor="end"{weight}>{escape(name[-52:])}</text>')
        if share.share is None or share.low is None or share.high is None:
            continue
        x0, x, x1 = (left + width * value for value in (share.low, share.share, share.high))
        thick = 3 if is_all else 1.5
        marks.append(f'<line x1="{x0:.1f}" y1="{y}" x2="{x1:.1f}" y2="{y}" stroke="#1f5fbf" stroke-width="{thick}"/>')
        marks.append(f'<circle cx="{x:.1f}" cy="{y}" r="{4.5 if is_all else 3}" fill="#1f5fbf"/>')
        marks.append(f'<text x="{left + width + 12}" y="{y + 4}">{100 * share.share:.1f} %</text>')
    size = f'width="{left + width + 80}" height="{30 + high * len(rows)}"'
    return f'<div class="wide"><svg {size} role="img" aria-label="Success rates">{"".join(marks)}</svg></div>'


def _notes(policies: Sequence[PolicyScores]) -> str:
    lines = (
        f"<li><b>{escape(policy.policy)}</b> goes by {escape(policy.knows)}: {escape(ends_of(policy))}"
        f"{''.join(f'<br>{escape(line)}' for line in faults_in_words(policy))}</li>"
        for policy in policies
    )
    return f"<ul>{''.join(lines)}</ul>"


def _groups(policies: Sequence[PolicyScores]) -> Iterable[str]:
    for by, title in GROUPS.items():
        rows = [(name, policy.policy, *_cells(group)) for name, policy, group in side_by_side(policies, by)]
        if rows:
            yield f"<h2>{title}</h2>" + _table((by, "policy", *_HEAD), rows)


def _ablations(policies: Sequence[PolicyScores]) -> str:
    rows = list(ablation_rows(policies, _share, _estimate))
    if not rows:
        return ""
    deaf = deaf_policies(policies)
    remark = f"<p>Gap 0 by construction, as they read no instruction: {escape(', '.join(deaf))}.</p>" if deaf else ""
    head = ("policy", "words", "episodes", "n", "success, %", "gap to the true words", "McNemar p")
    return f"<h2>Other words</h2>{_table(head, rows)}{remark}"


def _clips(policy: PolicyScores, failures: Sequence[Failure]) -> str:
    if not failures:
        return ""
    figures = []
    for row, video in failures:
        source = f"data:image/webp;base64,{base64.b64encode(video).decode()}"
        words = escape(row.instruction) or "<i>no instruction</i>"
        facts = (
            f"{row.scene}, {row.tier}, {row.split}; {row.target_id}; NE {row.final_ne_m:.2f} m, {row.num_steps} steps"
        )
        figures.append(
            f'<figure><img src="{source}" alt="{escape(row.spec_id)}" loading="lazy"><figcaption><b>{words}</b><br>'
            f"{escape(row.spec_id)}: {escape(row.end)}<br>{escape(facts)}<br>{escape(row.detail)}</figcaption></figure>"
        )
    return f'<h2>Failures of {escape(policy.policy)}</h2><div class="clips">{"".join(figures)}</div>'


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in map(_safe, row)) + "</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


class _Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def _safe(cell: object) -> str:
    return cell if isinstance(cell, _Markup) else escape(str(cell))


def _cells(score: Score) -> tuple[object, ...]:
    return (
        score.n,
        _share(score.success),
        _share(score.any_instance),
        _estimate(score.spl),
        _estimate(score.soft_spl),
        _estimate(score.ne_m),
        _estimate(score.progress_final),
        _estimate(score.progress_max),
        _estimate(score.progress_normalised),
        _estimate(score.trajectory_length_m),
        _estimate(score.num_steps, 0),
        _share(score.collision),
        _share(score.contact),
        _share(score.timeout),
        _share(score.policy_failure),
    )


def _share(share: Share) -> _Markup:
    if share.share is None or share.low is None or share.high is None:
        return _Markup("-")
    return _Markup(f"{100 * share.share:.1f} <small>{100 * share.low:.0f} to {100 * share.high:.0f}</small>")


def _estimate(value: Estimate, digits: int = 2) -> _Markup:
    if value.mean is None:
        return _Markup("-")
    if value.low is None or value.high is None:
        return _Markup(f"{value.mean:.{digits}f}")
    return _Markup(f"{value.mean:.{digits}f} <small>{value.low:.{digits}f} to {value.high:.{digits}f}</small>")
