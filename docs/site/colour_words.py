"""Draws random targets of layouts of all families with their colour words, for inspection by eye.

Each tile shows a target in its room with its bounding box; the text below it has its category, colour word and prim.
Equal seeds give equal targets. Targets without a colour word are not drawn.

python docs/site/colour_words.py FOLDER [SEED] [COUNT]
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from PIL import Image
from scene_pictures import GAP_PX, layouts

from factory.scenes.pictures.sheet import draw_sheet, known_colours
from schemas.terms import BUILTIN_CATEGORIES
from workers.render.choose import open_renderer

COUNT = 100
LAYOUTS = 4
COLUMNS, ROWS = 5, 4
RENDERED_PX = 400


def main(folder: Path, seed: int, number: int) -> None:
    """Writes sheets of twenty targets each, as PNG, and prints the layout and prim of each target."""
    folder.mkdir(parents=True, exist_ok=True)
    tiles = list(draw_targets(np.random.default_rng(seed), number))
    for first in range(0, len(tiles), COLUMNS * ROWS):
        path = folder / f"colours_{first:03}.png"
        tile(tiles[first : first + COLUMNS * ROWS]).save(path, optimize=True)
        print(path)


def draw_targets(rng: np.random.Generator, number: int) -> Iterator[Image.Image]:
    """Yields a labelled tile for each target; families and their first layouts are drawn with equal probability."""
    families = list(BUILTIN_CATEGORIES)
    drawn = Counter((int(rng.integers(len(families))), int(rng.integers(LAYOUTS))) for _ in range(number))
    with open_renderer("auto", RENDERED_PX) as eye:
        for row, family in enumerate(families):
            for place, scene in enumerate(islice(layouts(family), LAYOUTS)):
                for target in known_colours(scene.info.targets, drawn[row, place], rng):
                    print(f"{scene.info.name}: {target.category} {target.colour} {target.prim_path}")
                    yield draw_sheet(eye, scene, [target], in_place=True, columns=1)


def tile(tiles: list[Image.Image]) -> Image.Image:
    """Returns the tiles, which have one size, in rows."""
    width, height = tiles[0].width + GAP_PX, tiles[0].height + GAP_PX
    sheet = Image.new("RGB", (COLUMNS * width - GAP_PX, -(-len(tiles) // COLUMNS) * height - GAP_PX), "white")
    for number, picture in enumerate(tiles):
        sheet.paste(picture, (number % COLUMNS * width, number // COLUMNS * height))
    return sheet


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(int(value) for value in [*sys.argv[2:], *("0", str(COUNT))[len(sys.argv) - 2 :]]))
