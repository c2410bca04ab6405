"""Draws a contact sheet of an episode: colour, depth and ids over time, and the track on the map. Writes no files."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from factory.visualize.panels import TrackMap, describe_error, show_depth, show_ids
from schemas.bundle import BundleReader
from schemas.scene import CompiledScene

__all__ = ["draw_contact_sheet"]

_TILE_PX = 240
_MARGIN_PX = 8
_HEAD_SHARE, _WORDS_SHARE, _FACTS_SHARE = 1 / 30, 1 / 80, 1 / 100
"""Heights of the header and of its two text lines, as shares of the sheet's width."""


def draw_contact_sheet(episode: BundleReader, scene: CompiledScene, columns: int = 6) -> Image.Image:
    """Returns a contact sheet: three rows of frames from start to end, the track on the map, and the instruction.

    Args:
        episode: Bundle of the episode.
        scene: Scene in which the episode was recorded, for the map.
        columns: Number of frames in a row.
    """
    steps = np.linspace(0, episode.length - 1, columns).round().astype(int)
    rows = [
        [episode.rgb(t) for t in steps],
        [show_depth(episode.depth(t)) for t in steps],
        [show_ids(episode.ids(t), episode.meta.target_instance_id) for t in steps],
    ]
    track = TrackMap(episode, scene, 3 * _TILE_PX).draw(episode.length)
    width = columns * _TILE_PX + track.width
    head = round(width * _HEAD_SHARE)
    sheet = Image.new("RGB", (width, head + 3 * _TILE_PX), "white")
    for row, tiles in enumerate(rows):
        for column, tile in enumerate(tiles):
            small = Image.fromarray(tile).resize((_TILE_PX, _TILE_PX), Image.Resampling.BILINEAR)
            sheet.paste(small, (column * _TILE_PX, head + row * _TILE_PX))
    sheet.paste(track, (columns * _TILE_PX, head))
    _write_head(sheet, episode)
    return sheet


def _write_head(sheet: Image.Image, episode: BundleReader) -> None:
    job, rollout = episode.meta.job, episode.meta.rollout
    words = f"{job.episode_id}  {job.scene}  {job.split}  {job.tier}  {job.instruction}"
    facts = (
        f"{job.target_id} ({job.colour})  attempt {job.attempt}  {rollout.num_steps} steps  "
        f"start {rollout.spawn_dist_m:.2f} m  TL {rollout.trajectory_length_m:.2f} m  {describe_error(rollout)}"
    )
    _write_line(sheet, 0.28, words, _WORDS_SHARE)
    _write_line(sheet, 0.72, facts, _FACTS_SHARE)


def _write_line(sheet: Image.Image, middle: float, text: str, share: float) -> None:
    """Writes a line of the header; reduces the font size where the text is wider than the sheet."""
    draw = ImageDraw.Draw(sheet)
    size = sheet.width * share
    over = draw.textlength(text, ImageFont.load_default(size)) / (sheet.width - 2 * _MARGIN_PX)
    font = ImageFont.load_default(size / max(1.0, over))
    draw.text((_MARGIN_PX, middle * sheet.width * _HEAD_SHARE), text, fill="black", font=font, anchor="lm")
