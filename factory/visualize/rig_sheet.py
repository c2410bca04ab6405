"""Draws a contact sheet of the cameras of a rig: a row for each camera, with colour over time, depth and ids.

Writes no files.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from factory.dataset.bundle import EpisodeBundle
from factory.dataset.observation import observe_camera
from factory.visualize.panels import show_depth, show_ids
from schemas.rig import Camera, CameraOutput, Rig

_TILE_PX, _LABEL_PX, _FONT_PX = 240, 20, 13
_SHOWN = (CameraOutput.RGB, CameraOutput.DEPTH, CameraOutput.IDS, CameraOutput.NORMALS)


def draw_rig_sheet(episode: EpisodeBundle, rig: Rig, columns: int) -> Image.Image:
    """Returns a sheet with a row for each camera: colour from start to end, then depth, ids and normals in the middle.

    Args:
        episode: bundle of the episode.
        rig: rig with at least one camera; its other sensors are not drawn. Normals are drawn if a camera has them.
        columns: number of colour images in a row.
    """
    rows = [_row(episode, camera, columns) for camera in rig.cameras]
    heights = [max(tile.height for tile in row) + _LABEL_PX for row in rows]
    sheet = Image.new("RGB", (max(map(len, rows)) * _TILE_PX, sum(heights)), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(_FONT_PX)
    top = 0
    for camera, row, height in zip(rig.cameras, rows, heights, strict=True):
        pen.text((4, top + _LABEL_PX / 2), _label(camera), fill="black", font=font, anchor="lm")
        for column, tile in enumerate(row):
            sheet.paste(tile, (column * _TILE_PX, top + _LABEL_PX))
        top += height
    return sheet


def _row(episode: EpisodeBundle, camera: Camera, columns: int) -> list[Image.Image]:
    stride = camera.stride(episode.meta.job.task.control_hz)
    steps = np.linspace(0, (episode.length - 1) // stride, columns).round().astype(int) * stride
    colour = camera.model_copy(update={"outputs": (CameraOutput.RGB,)})
    frames = [observe_camera(episode, colour, int(t)).rgb for t in steps]
    shown = (*_SHOWN[:3], *(output for output in _SHOWN[3:] if output in camera.outputs))
    middle = observe_camera(episode, camera.model_copy(update={"outputs": shown}), int(steps[columns // 2]))
    assert middle.depth is not None
    assert middle.ids is not None
    pictures = [show_depth(middle.depth), show_ids(middle.ids, episode.meta.target_instance_id)]
    if middle.normals is not None:
        pictures.append(((middle.normals + 1) * 127.5).astype(np.uint8))
    return [_tile(picture) for picture in (*frames, *pictures) if picture is not None]


def _tile(picture: NDArray[np.uint8]) -> Image.Image:
    height = max(1, round(_TILE_PX * picture.shape[0] / picture.shape[1]))
    return Image.fromarray(picture).resize((_TILE_PX, height), Image.Resampling.BOX)


def _label(camera: Camera) -> str:
    return f"{camera.name}  {camera.model}  {camera.width} x {camera.height} px"
