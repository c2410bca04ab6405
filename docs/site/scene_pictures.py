"""Renders the pictures of docs/scenes: views, frames, categories and map of every scene; maps and views of every family.

A family has one sheet of maps and one of views, with one layout of each seed. Seeds without a layout are left out.

python docs/site/scene_pictures.py [SCENE|FAMILY ...]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageOps

SCENES = ("office", "hospital", "full_warehouse", "warehouse_multiple_shelves")
FAMILIES = ("home", "shop", "school")
LAYOUTS = 12
FOLDER = Path(__file__).parents[1] / "scenes"
GAP_PX = 4


def main(scenes: Sequence[str]) -> None:
    """Writes four pictures of each scene, and three of each family."""
    for scene in scenes:
        if scene in FAMILIES:
            draw_family(scene)
            continue
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


def draw_family(family: str) -> None:
    """Writes the maps and one view of the first layouts of a family, and the categories of the first one."""
    with tempfile.TemporaryDirectory() as folder:
        drawn: list[Path] = []
        for seed in range(2 * LAYOUTS):
            one = Path(folder) / f"{seed:02d}"
            command = ["factory", "scene", "render", family, "--seed", str(seed), "-o", str(one), "--views", "2"]
            done = subprocess.run([*command, "--robot-views", "0"], check=False, stdout=subprocess.DEVNULL)
            drawn += [one] if done.returncode == 0 else []
            if len(drawn) == LAYOUTS:
                break
        save(tile([one / "map.png" for one in drawn], columns=4, size_px=340, fill="white"), f"{family}_maps.jpg", 80)
        views = [one / f"eye_{number % 2:02d}.png" for number, one in enumerate(drawn)]
        save(tile(views, columns=4, size_px=340), f"{family}_views.jpg", 80)
        categories = Image.open(drawn[0] / "categories.png").convert("RGB")
        categories.thumbnail((1400, 1600))
        save(categories, f"{family}_categories.jpg", 80)


def tile(pictures: Sequence[Path], columns: int, size_px: int, fill: str | None = None) -> Image.Image:
    """Returns the pictures in rows of `columns` squares of `size_px`; with `fill`, they keep their proportions."""
    rows, step = -(-len(pictures) // columns), size_px + GAP_PX
    sheet = Image.new("RGB", (columns * step - GAP_PX, rows * step - GAP_PX), fill or "white")
    for number, path in enumerate(pictures):
        picture = Image.open(path).convert("RGB")
        if fill is None:
            picture = picture.resize((size_px, size_px), Image.Resampling.LANCZOS)
        else:
            picture = ImageOps.pad(picture, (size_px, size_px), Image.Resampling.LANCZOS, fill)
        sheet.paste(picture, (number % columns * step, number // columns * step))
    return sheet


def save(picture: Image.Image, name: str, quality: int = 85) -> None:
    """Writes a JPEG."""
    picture.save(FOLDER / name, quality=quality, optimize=True)
    print(FOLDER / name)


if __name__ == "__main__":
    main(sys.argv[1:] or (*SCENES, *FAMILIES))
