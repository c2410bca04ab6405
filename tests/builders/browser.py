"""Opens pages in Chromium and checks them with axe-core."""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""The last two flags make Chromium render WebGL on the CPU."""
_NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
"""Browsers, in order of preference. The first runs only headless and needs a third less CPU time than the others."""


def _find() -> str | None:
    return next((path for path in map(shutil.which, _NAMES) if path), None)


def why_no_chromium() -> str:
    """Returns why no page can be opened; empty if Chromium is available."""
    if importlib.util.find_spec("axe_playwright_python") is None:
        return "axe-playwright-python is not installed: install the extra dev"
    return "" if _find() else f"no {', '.join(_NAMES)} on the PATH: apt-get install chromium-headless-shell"


@contextmanager
def chromium() -> Iterator[Any]:
    """Yields a headless browser, a `playwright.sync_api.Browser`."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=_find(), args=_FLAGS)
        yield browser
        browser.close()


@contextmanager
def opened(browser: Any, path: Path, width: int, scheme: str) -> Iterator[Any]:
    """Yields the page of a file.

    Args:
        browser: result of `chromium`.
        path: path of the HTML file.
        width: width of the window, pixels.
        scheme: `light` or `dark`.
    """
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.goto(path.resolve().as_uri())
    yield page
    page.close()


def axe_violations(page: Any) -> list[tuple[str, list[str]]]:
    """Returns the rules of axe-core that a page violates, each with the markup of its elements."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [(rule["id"], [node["html"] for node in rule["nodes"]]) for rule in found]


def overflow_px(page: Any) -> int:
    """Returns by how many pixels a page is wider than its window; 0 if it fits."""
    return int(page.evaluate("document.scrollingElement.scrollWidth - innerWidth"))
