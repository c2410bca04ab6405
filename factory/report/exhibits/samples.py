"""Sample frames with their instructions (paper Fig. 3): the target is outlined, which the recording is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from factory.report.canvas import Axes, Panel, draw_panel
from factory.report.exhibit import Exhibit
from factory.report.exhibits.words import count, name
from factory.report.material import Material, Sample

__all__ = ["draw", "outlined"]

_OUTLINE_RGB = (255, 196, 0)
_OUTLINE_PX = 2


def draw(material: Material) -> Exhibit:
    """Returns one panel a sample."""
    samples = material.drives.samples
    scenes = len({sample.row.scene for sample in samples})
    caption = (
        f"Front RGB frames, 640 × 640 pixels as recorded, of {count(len(samples), 'episode')} in "
        f"{count(scenes, 'scene')}, chosen by rule: scenes and categories take turns. The yellow outline shows the "
        "target's pixels in the recorded ids; the frames themselves have none."
    )
    return Exhibit(
        name="samples",
        title="What the robot sees",
        source="Fig. 3",
        caption=caption if samples else "No frames to show: no episode could be read.",
        panels=tuple(_panel(sample) for sample in samples),
        wide=True,
    )


def outlined(sample: Sample) -> NDArray[np.uint8]:
    """Returns the frame with its target's outline: (640, 640, 3) sRGB."""
    mask = sample.target
    inner = mask.copy()
    for _ in range(_OUTLINE_PX):
        padded = np.pad(inner, 1, mode="edge")
        inner = inner & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    shown = sample.rgb.copy()
    shown[mask & ~inner] = _OUTLINE_RGB
    return shown


def _panel(sample: Sample) -> Panel:
    row = sample.row

    def paint(axes: Axes) -> None:
        axes.imshow(outlined(sample), interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(f"{name(row.scene)} · {name(row.target_category)}\n{row.instruction}", wrap=True)

    alt = f"Frame {sample.t} of {row.episode_id}, {name(row.scene)}: {row.instruction}"
    return draw_panel(f"sample_{row.episode_id}", alt, paint, height_in=5.5)
