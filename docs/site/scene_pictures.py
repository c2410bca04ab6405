"""Renders the pictures of docs/scenes: views, frames, categories and map of every built-in scene.

python docs/site/scene_pictures.py [SCENE ...]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

SCENES = ("office", "hospital", "full_warehouse", "warehouse_multiple_shelves")
FOLDER = Path(__file__).parents[1] / "scenes"
GAP_PX = 4


def main(scenes: Sequence[str]) -> None:
    """Writes four pictures of each scene."""
    for scene in scenes:
        with tempfile.TemporaryDirectory() as folder:
            rendered = Path(folder)
            subprocess.run(["factory", "scene", "render", scene, "-o", folder], check=True, stdout=subprocess.DEVNULL)
            save(tile(sorted(rendered.glob("eye_*.png")), columns=3, size_px=420), f"{scene}_eye.jpg")
            save(tile(sorted(rendered.glob("robot_*.png")), columns=4, size_px=320), f"{scene}_robot.jpg")
            categories = Image.open(rendered / "categories.png").convert("RGB")
            categories.thumbnail((1600, 1600))
            save(categories, f"{scene}_categories.jpg")
            Image.open(rendered / "map.png").convert("RGB").quantize(64).save(
                FOLDER / f"{scene}_map.png", optimize=True
            )


def tile(pictures: Sequence[Path], columns: int, size_px: int) -> Image.Image:
    """Returns the pictures in rows of `columns` squares of `size_px`."""
    rows, step = -(-len(pictures) // columns), size_px + GAP_PX
    sheet = Image.new("RGB", (columns * step - GAP_PX, rows * step - GAP_PX), "white")
    for number, path in enumerate(pictures):
        picture = Image.open(path).convert("RGB").resize((size_px, size_px), Image.Resampling.LANCZOS)
        sheet.paste(picture, (number % columns * step, number // columns * step))
    return sheet


def save(picture: Image.Image, name: str) -> None:
    """Writes a JPEG."""
    picture.save(FOLDER / name, quality=85, optimize=True)
    print(FOLDER / name)


if __name__ == "__main__":
    main(sys.argv[1:] or SCENES)
