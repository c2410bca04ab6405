"""Draws the curve of a training, and its page: losses, errors and pointing by epoch. Trains nothing.

Needs matplotlib, which the extra `train` contains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from factory.html import render
from factory.html.palette import colour
from factory.report.drawing.canvas import Axes, Panel, count_whole, draw_panel, write_legend
from factory.train.checkpoint import write_atomically
from factory.train.measures import EpochMeasures, TrainReport, describe_kept

CURVE, PAGE = "curve.png", "index.html"
"""File names in a training folder."""


def write_curve(out: Path, report: TrainReport, commands: Sequence[str]) -> None:
    """Writes the curve as a picture, and the page of a training with at least one epoch.

    Args:
        out: Training folder.
        report: Report of the training.
        commands: Commands to run next, for the page.

    Raises:
        WorldError: A file cannot be written.
    """
    panels = _panels(report)
    write_atomically(out / CURVE, panels[0].png)
    fields = list(EpochMeasures.model_fields)
    page = render(
        "training.html",
        title=f"{out.name}: training",
        kicker="Training by behaviour cloning",
        run=out.name,
        badges=[
            f"{report.train_episodes} episodes",
            f"{report.val_episodes} episodes for validation",
            f"{len(report.epochs)} of {report.options.epochs} epochs",
        ],
        digest=None,
        contents=[("curve", "Curve"), ("epochs", "Epochs"), ("next", "Next")],
        kept=describe_kept(report),
        panels=panels,
        head=[name.replace("_", " ") for name in fields],
        rows=[
            (epoch.epoch == report.policy_epoch, [_text(getattr(epoch, name)) for name in fields])
            for epoch in report.epochs
        ],
        commands=commands,
    )
    write_atomically(out / PAGE, page.encode())


def _panels(report: TrainReport) -> list[Panel]:
    losses = {"training": "train_loss", "validation": "val_loss"}
    errors = {"v, m/s": "val_v_mps", "w, rad/s": "val_w_rps"}
    shares = {"pointing": "pointing", "stop precision": "stop_precision", "stop recall": "stop_recall"}
    drawings = (
        ("losses", "Losses by epoch", losses, "loss"),
        ("errors", "Validation errors by epoch", errors, "mean absolute error"),
        ("shares", "Pointing and stops by epoch", shares, "share of the frames"),
    )
    return [
        draw_panel(name, title, _lines(report, series, unit))
        for name, title, series, unit in drawings
        if any(getattr(epoch, field) is not None for epoch in report.epochs for field in series.values())
    ]


def _lines(report: TrainReport, series: dict[str, str], unit: str) -> Callable[[Axes], None]:
    def paint(axes: Axes) -> None:
        styles = zip(("scene1", "scene2", "scene3"), ("-", "--", ":"), strict=True)
        for (label, field), (name, dashes) in zip(series.items(), styles, strict=False):
            points = [(epoch.epoch, getattr(epoch, field)) for epoch in report.epochs]
            known = [(epoch, value) for epoch, value in points if value is not None]
            if known:
                axes.plot(*zip(*known, strict=True), dashes, marker=".", color=colour(name), label=label)
        if report.policy_epoch is not None:
            axes.axvline(report.policy_epoch, color=colour("muted"), linewidth=0.8, label="epoch of the policy")
        axes.set_xlabel("epoch")
        axes.set_ylabel(unit)
        count_whole(axes.xaxis)
        write_legend(axes, columns=2)

    return paint


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
