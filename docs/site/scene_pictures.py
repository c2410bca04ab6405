"""Renders the pictures of docs/scenes.

For the layout of each paper scene: views, frames, categories and map. For each family: a sheet of maps and a sheet of
views, with its first twelve layouts. Seeds for which the builder finds no layout are omitted.

python docs/site/scene_pictures.py [FAMILY ...]
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from itertools import count, islice
from pathlib import Path

from PIL import Image, ImageOps

from factory.scenes.build import build_scene
from factory.scenes.pictures.sheet import draw_sheet, variants
from factory.scenes.pictures.viewpoints import EYE, best_views
from factory.scenes.topdown import encode_topdown
from factory.support.settings import scene_cache
from schemas.errors import LayoutError
from schemas.scene import CompiledScene, read_scene
from schemas.terms import BUILTIN_CATEGORIES, PAPER_SCENES, layout_name
from workers.render.choose import open_renderer

LAYOUTS = 12
TILE_PX = 420
RANKS = 3
"""Number of ranks of views. The first layout of a sheet shows its best view, the next its second best, and so on, so a
sheet shows different kinds of rooms."""
FOLDER = Path(__file__).parents[1] / "scenes"
GAP_PX = 4


def main(families: Sequence[str]) -> None:
    """Writes the sheets of each family, and the pictures of the paper's layout if the family has one."""
    for family in families:
        if family in PAPER_SCENES:
            draw_paper_scene(family)
        draw_family(family)


def draw_paper_scene(scene: str) -> None:
    """Writes the views, frames, categories and map of a layout of the paper."""
    with tempfile.TemporaryDirectory() as folder:
        rendered = Path(folder)
        subprocess.run(["factory", "scene", "render", scene, "-o", folder], check=True, stdout=subprocess.DEVNULL)
        save(tile(opened(rendered, "eye_*.png"), columns=3, size_px=420), f"{scene}_eye.jpg")
        save(tile(opened(rendered, "robot_*.png"), columns=4, size_px=320), f"{scene}_robot.jpg")
        categories = Image.open(rendered / "categories.png").convert("RGB")
        categories.thumbnail((1600, 1600))
        save(categories, f"{scene}_categories.jpg")
        Image.open(rendered / "map.png").convert("RGB").quantize(64).save(FOLDER / f"{scene}_map.png", optimize=True)


def draw_family(family: str) -> None:
    """Writes the maps and views of the first layouts of a family.

    Also writes the categories of the first layout, unless `draw_paper_scene` writes them for this family.
    """
    maps: list[Image.Image] = []
    views: list[Image.Image] = []
    for scene in islice(layouts(family), LAYOUTS):
        if not maps and family not in PAPER_SCENES:
            draw_categories(scene, family)
        maps.append(Image.open(io.BytesIO(encode_topdown(scene))))
        views.append(draw_view(scene, len(views) % RANKS))
    save(tile(maps, 4, TILE_PX, fill="white"), f"{family}_maps.jpg", 75)
    save(tile(views, 4, TILE_PX), f"{family}_views.jpg", 78)


def layouts(family: str) -> Iterator[CompiledScene]:
    """Yields the layouts of a family in the order of their seeds."""
    for seed in count():
        try:
            package = build_scene(family, seed, scene_cache(), called=layout_name(family, seed))
        except LayoutError as error:
            print(error)
            continue
        yield read_scene(package)


def draw_categories(scene: CompiledScene, family: str) -> None:
    """Writes a picture with the object variants of each category of a layout."""
    with open_renderer("auto", 400) as eye:
        categories = draw_sheet(eye, scene, variants(scene.info.targets))
    categories.thumbnail((1400, 1600))
    save(categories, f"{family}_categories.jpg", 80)


def draw_view(scene: CompiledScene, rank: int) -> Image.Image:
    """Returns one of the best views of a scene at eye height; rank 0 is the best."""
    with open_renderer("auto", 96) as eye:
        view = best_views(eye, scene, EYE, rank + 1)[-1]
    with open_renderer("auto", 2 * TILE_PX) as eye:
        eye.load(scene, view.camera)
        return Image.fromarray(eye.render(view.pose).rgb)


def opened(folder: Path, pattern: str) -> list[Image.Image]:
    """Opens the pictures of a folder whose file names match a pattern, in the order of their names."""
    return [Image.open(path) for path in sorted(folder.glob(pattern))]


def tile(pictures: Sequence[Image.Image], columns: int, size_px: int, fill: str | None = None) -> Image.Image:
    """Returns one picture with all pictures in rows of `columns` squares of `size_px` pixels.

    Without `fill`, a picture is stretched to its square; with `fill`, it is padded with this colour.
    """
    rows, step = -(-len(pictures) // columns), size_px + GAP_PX
    sheet = Image.new("RGB", (columns * step - GAP_PX, rows * step - GAP_PX), fill or "white")
    for number, original in enumerate(pictures):
        picture = original.convert("RGB")
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
    main(sys.argv[1:] or tuple(BUILTIN_CATEGORIES))
