"""Takes screenshots of the web page of a dataset in Chromium: of all pages for an inspection, or those of docs/web.

python docs/site/web_pictures.py DATASET --eval RESULTS -o FOLDER     every page, in three widths, light and dark
python docs/site/web_pictures.py DATASET --eval RESULTS --docs        the pictures of docs/web

RESULTS must contain at least two policies. Needs the extras `web` and `dev`, and Chromium.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image
from playwright.sync_api import sync_playwright

from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.web.start import serve

FOLDER = Path(__file__).parents[1] / "web"
WINDOWS = ((360, "dark"), (1280, "light"), (3840, "dark"), (360, "light"), (1280, "dark"), (3840, "light"))
"""Width of the window in pixels and colour scheme of each screenshot of a page."""
COLOURS = 255
"""Number of colours of the pictures of docs/web, so they stay small."""
_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


class Shot(NamedTuple):
    """Picture of docs/web."""

    page: str
    """Name of the page."""
    width: int
    """Width of the window, pixels."""
    height: int
    """Height of the window, pixels."""
    scheme: str
    """`light` or `dark`."""
    shown: int = 0
    """Width of the picture, pixels; 0 keeps the width of the window."""


DOCS = {
    "farm": Shot("farm", 1280, 1000, "light", 900),
    "episode": Shot("episode", 1280, 900, "light", 900),
    "scene3d": Shot("scene3d", 1280, 880, "light", 700),
    "evaluation": Shot("evaluation", 1280, 920, "light", 700),
    "episode_wide": Shot("episode", 3840, 1728, "dark", 1600),
    "episode_narrow": Shot("episode", 360, 857, "dark", 300),
    "statistics_narrow": Shot("statistics", 360, 857, "dark", 300),
}


def main() -> None:
    """Draws the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--eval", type=Path, required=True, dest="evaluation")
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument("-o", type=Path, dest="folder")
    target.add_argument("--docs", action="store_true")
    given = parser.parse_args()
    paths = _paths(given.dataset, given.evaluation)
    with (
        _browser() as browser,
        serve(site_of(str(given.dataset)), "127.0.0.1:0", None, evaluations=[given.evaluation]) as url,
    ):
        if given.docs:
            for name, shot in DOCS.items():
                _draw(browser, url, paths[shot.page], shot, FOLDER / f"{name}.png", whole=False)
                _reduce(FOLDER / f"{name}.png", shot.shown)
            return
        given.folder.mkdir(parents=True, exist_ok=True)
        for (width, scheme), name in product(WINDOWS, paths):
            path = given.folder / f"{name}_{width}_{scheme}.png"
            _draw(browser, url, paths[name], Shot(name, width, 900, scheme), path, whole=True)


def _paths(root: Path, evaluation: Path) -> dict[str, str]:
    """Returns the name and the URL path of each page."""
    dataset, policies = Dataset(root), sorted(path.name for path in (evaluation / "policies").iterdir())
    episode = dataset[len(dataset) // 4]
    name, scene = episode.meta.job.episode_id, episode.meta.job.scene
    return {
        "farm": "/",
        "episodes": "/episodes",
        "episode": f"/episodes/{name}?t={len(episode) // 2}",
        "scenes": "/scenes",
        "scene": f"/scenes/{scene}",
        "scene3d": f"/scenes/{scene}/3d?episode={name}",
        "statistics": "/statistics",
        "evaluations": "/evaluations",
        "evaluation": f"/evaluations/{evaluation.resolve().name}",
        "comparison": f"/evaluations/{evaluation.resolve().name}?first={policies[0]}&second={policies[-1]}",
        "operation": "/operations/retry",
        "login": "/login",
        "missing": "/episodes/ep_999999",
    }


@contextmanager
def _browser() -> Iterator[Any]:
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=_FLAGS)
        yield browser
        browser.close()


def _draw(browser: Any, url: str, path: str, shot: Shot, file: Path, whole: bool) -> None:
    address, _, token = url.partition("/?token=")
    viewport = {"width": shot.width, "height": shot.height}
    context = browser.new_context(viewport=viewport, color_scheme=shot.scheme)
    context.set_default_timeout(300_000)
    page = context.new_page()
    page.goto(f"{address}/?token={token}")
    page.goto(address + path)
    if shot.page == "statistics":
        page.wait_for_selector("section.figures")
    if shot.page == "scene3d":
        page.wait_for_selector("#scene3d[data-drawn]")
    page.evaluate("Promise.all([...document.images].map(image => { image.loading = 'eager'; return image.decode(); }))")
    page.screenshot(path=file, full_page=whole)
    context.close()


def _reduce(file: Path, width: int) -> None:
    picture = Image.open(file).convert("RGB")
    picture = picture.resize((width, round(picture.height * width / picture.width)), Image.Resampling.LANCZOS)
    picture.quantize(COLOURS).save(file, optimize=True)


if __name__ == "__main__":
    main()
