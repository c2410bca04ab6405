"""The web page in Chromium: axe finds no violation, episodes play and show the pixels of the dataset."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from factory.dataset.reader import Dataset
from tests.builders.browser import axe_violations, chromium, overflow_px, why_no_chromium
from tests.builders.dataset import make_dataset
from tests.builders.web import WebClient, web_page

REASON = why_no_chromium()
pytestmark = pytest.mark.skipif(bool(REASON), reason=REASON)

_PATHS = ("/", "/episodes", "/episodes/ep_000001", "/scenes", "/scenes/office", "/operations/retry", "/episodes/ep_9")
_SHOWN = """
async kind => {
  const image = document.querySelector(`img[data-kind=${kind}]`);
  await image.decode();
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
  const pen = canvas.getContext("2d");
  pen.drawImage(image, 0, 0);
  const {data} = pen.getImageData(0, 0, canvas.width, canvas.height);
  const colours = new Uint8Array(data.length / 4 * 3);
  for (let at = 0; at < data.length / 4; at++) colours.set(data.subarray(4 * at, 4 * at + 3), 3 * at);
  const digest = await crypto.subtle.digest("SHA-256", colours);
  return [...new Uint8Array(digest)].map(byte => byte.toString(16).padStart(2, "0")).join("");
}
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("web") / "data"
    make_dataset(root, 3)
    return root


@pytest.fixture(scope="module")
def client(data: Path) -> Iterator[WebClient]:
    with web_page(data) as found:
        yield found


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@contextmanager
def tab(
    browser: Any, client: WebClient, width: int = 1280, scheme: str = "light", script: bool = True
) -> Iterator[Any]:
    """Yields a page that is logged in; any message of the console is an error."""
    viewport = {"width": width, "height": 900}
    context = browser.new_context(viewport=viewport, color_scheme=scheme, java_script_enabled=script)
    context.set_default_timeout(60_000)
    page = context.new_page()
    messages: list[str] = []
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.on("console", lambda line: messages.append(line.text) if "Content Security Policy" in line.text else None)
    page.goto(f"{client.url}/?token={client.token}")
    try:
        yield page
    finally:
        context.close()
    assert messages == []


@pytest.mark.slow
@pytest.mark.parametrize(("width", "scheme"), [(360, "dark"), (1400, "light")])
def test_axe_finds_no_violation_and_no_page_is_wider_than_its_window(browser, client, width, scheme):
    with tab(browser, client, width, scheme) as page:
        for path in _PATHS:
            page.goto(client.url + path)
            assert overflow_px(page) <= 0, path
            assert axe_violations(page) == [], path


def test_a_played_episode_ends_at_its_last_step_with_the_pixels_of_the_dataset(browser, client, data):
    episode = Dataset(data)["ep_000002"]
    last = len(episode) - 1
    with tab(browser, client) as page:
        page.goto(f"{client.url}/episodes/ep_000002")
        before = page.locator("#robot").get_attribute("transform")
        page.click("#play")
        page.wait_for_selector(f'#player[data-t="{last}"]')
        page.wait_for_selector('#play[aria-pressed="false"]')
        shown = page.evaluate(_SHOWN, "rgb")
        assert page.locator("#time").input_value() == str(last)
        assert page.locator("#robot").get_attribute("transform") != before
    assert shown == hashlib.sha256(episode.rgb(last).tobytes()).hexdigest()


def test_the_pointer_names_the_object_and_a_note_is_stored(browser, client, data):
    with tab(browser, client) as page:
        page.goto(f"{client.url}/episodes/ep_000001")
        page.hover("img[data-kind=ids]")
        page.wait_for_function("document.getElementById('object').textContent.length > 2")
        page.check("input[name=flagged]")
        page.fill("textarea[name=note]", "seen in a browser")
        with page.expect_navigation():
            page.click("#mark button")
        page.goto(f"{client.url}/episodes?flagged=1")
        assert "seen in a browser" in page.locator("main").inner_text()
    (data / "marks.json").unlink()


def test_pages_are_readable_without_javascript(browser, client):
    with tab(browser, client, script=False) as page:
        page.goto(f"{client.url}/episodes?sort=num_steps")
        page.click("text=ep_000003")
        assert page.locator("img[data-kind=rgb]").is_visible()
        page.click("text=30 steps on")
        assert page.locator("img[data-kind=rgb]").get_attribute("alt") == "colour at step 11"
        page.click("nav >> text=Farm")
        assert "Archived episodes" in page.locator("main").inner_text()
