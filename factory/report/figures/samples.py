"""Figure of sample frames with their instructions (paper Fig. 3). The outline of the target is added."""

from __future__ import annotations

import textwrap

import numpy as np
from numpy.typing import NDArray

from factory.report.data import FrameSample, ReportInput
from factory.report.drawing.canvas import WIDTH_IN, Axes, draw_panel
from factory.report.drawing.figure import Figure
from factory.report.drawing.text import count, name

_OUTLINE_RGB = (255, 196, 0)
_OUTLINE_PX = 2
_COLUMNS = 2
_SHRINK = 2
"""Downsampling factor of the panel; the page has separate images."""
_TILE_PX, _GAP_PX, _TEXT_PX = 320, 14, 74
_LETTERS = 36


def draw(material: ReportInput) -> Figure:
    """Returns one panel with all samples."""
    samples = material.drives.samples
    title, source = "Sample frames", "Fig. 3"
    if not samples:
        return Figure("samples", title, source, "No frames to show: no episode could be read.", wide=True)
    scenes = len({sample.row.scene for sample in samples})
    caption = (
        f"Front RGB frames, 640 × 640 pixels as recorded, of {count(len(samples), 'episode')} in "
        f"{count(scenes, 'scene')}, selected alternately from each scene and category. The yellow outline shows the "
        "target's pixels in the recorded instance ids; it is not part of the recorded frames."
    )
    rows = -(-len(samples) // _COLUMNS)
    height = WIDTH_IN * rows * (_TILE_PX + _TEXT_PX) / (_COLUMNS * (_TILE_PX + _GAP_PX))
    panel = draw_panel("samples", "Sample frames with instructions", lambda axes: _paint(axes, samples), height)
    return Figure("samples", title, source=source, caption=caption, panels=(panel,), wide=True)


def outlined(sample: FrameSample) -> NDArray[np.uint8]:
    """Returns the frame with the outline of the target: (640, 640, 3) sRGB."""
    mask = sample.target
    inner = mask.copy()
    for _ in range(_OUTLINE_PX):
        padded = np.pad(inner, 1, mode="edge")
        inner = inner & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    shown = sample.rgb.copy()
    shown[mask & ~inner] = _OUTLINE_RGB
    return shown


def _paint(axes: Axes, samples: list[FrameSample]) -> None:
    turns = [samples[start : start + _COLUMNS] for start in range(0, len(samples), _COLUMNS)]
    for row, turn in enumerate(turns):
        for column, sample in enumerate(turn):
            left, top = column * (_TILE_PX + _GAP_PX), row * (_TILE_PX + _TEXT_PX)
            tile = outlined(sample)[::_SHRINK, ::_SHRINK]
            axes.imshow(tile, extent=(left, left + _TILE_PX, top + _TILE_PX, top), interpolation="none")
            words = textwrap.shorten(sample.row.instruction, 2 * _LETTERS, placeholder=" …")
            axes.text(left, top + _TILE_PX + 8, textwrap.fill(words, _LETTERS), va="top", fontsize=7.5, style="italic")
            place = f"{name(sample.row.scene)} · {name(sample.row.target_category)}"
            axes.text(left, top + _TILE_PX + 52, place, va="center", fontsize=7)
    axes.set_xlim(0, _COLUMNS * (_TILE_PX + _GAP_PX) - _GAP_PX)
    axes.set_ylim(len(turns) * (_TILE_PX + _TEXT_PX), 0)
    axes.set_axis_off()
