"""The web page in Chromium: axe finds no violation, episodes play and show the pixels of the dataset."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from starlette.routing import Match

from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.eval.results.publish import pair_folder
from factory.visualize.panels import show_depth, show_ids
from factory.web.app import all_routes
from factory.web.pages.farm import read_view
from factory.web.recent import Recent
from factory.web.workspace import Workspace
from schemas.support.geometry import yaw_of
from schemas.terms import FailReason, Recording
from tests.builders.browser import axe_violations, chromium, overflow_px, why_no_chromium
from tests.builders.dataset import make_dataset
from tests.builders.eval_results import write_evaluation
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.web import WebClient, web_page
from tests.builders.wire_worker import WireWorker, bundle_for

REASON = why_no_chromium()
pytestmark = pytest.mark.skipif(bool(REASON), reason=REASON)

_PAGES = (
    *(
        "/",
        "/gallery",
        "/farm",
        "/episodes",
        "/episodes/ep_000001",
        "/pair?first=ep_000001&second=ep_000002",
        "/scenes",
        "/scenes/{scene}",
        "/scenes/{scene}/3d?episode=ep_000001",
    ),
    *("/statistics", "/evaluations", "/evaluations/results?first=a&second=b", "/operations/retry", "/login"),
    "/episodes/ep_9",
)
_FILES = (
    *(
        "/episodes/ep_000001/thumbnail.jpg",
        "/episodes/ep_000001/mask.svg",
        "/episodes/ep_000001/playback/0",
        "/episodes/ep_000001/download/zip",
    ),
    *("/episodes/ep_000001/objects.json", "/scenes/{scene}/failures.svg", "/evaluations/results/films/0/ep_000001.jpg"),
    "/evaluations/results/pairs/0/1/ep_000002.jpg",
)
"""Files that pages load only after a click, or only for some datasets."""
_WIDTHS_PX = (360, 1400, 3840)
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
_DRAWN = """
() => {
  const canvas = document.getElementById("outline");
  const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return [...data].filter((_, place) => place % 4 === 3).map(alpha => alpha > 0);
}
"""
"""Returns for each pixel of the outline whether it is drawn."""
_ARE_WHOLE = """
() => [...document.querySelectorAll("img[data-kind]")].every(image => image.complete && image.naturalWidth === 640)
"""
_PLAY_UNTIL_SMALL = """
() => new Promise(resolve => {
  const [images, play] = [[...document.querySelectorAll("img[data-kind]")], document.getElementById("play")];
  const look = () => {
    if (!images.every(image => image.naturalWidth === 320)) return requestAnimationFrame(look);
    play.click();
    resolve();
  };
  play.click();
  look();
})
"""
"""Plays the episode, and pauses it at the first frame with small images."""


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
    """Yields a logged-in page; script errors and violations of the Content Security Policy fail the test."""
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


@pytest.fixture(scope="module", params=list(Recording))
def served(
    request, data, recordings, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[WebClient, Workspace]]:
    """The web page of a dataset with an evaluation; once for a dataset of frames and once for a dataset of states."""
    root: Path = data if request.param is Recording.FRAMES else recordings[request.param]
    results = write_evaluation(tmp_path_factory.mktemp("served") / "results", "ab")
    films = pair_folder(results, "a", "b")
    films.mkdir(parents=True)
    for suffix in (".jpg", ".mp4"):
        (films / f"ep_000002{suffix}").write_bytes(b"film of an episode that only one policy completed")
    with web_page(root, evaluations=(results,)) as client:
        yield client, Workspace(site_of(str(root)))


@pytest.mark.slow
def test_axe_finds_no_violation_on_any_page_and_every_route_was_visited(browser, served):
    client, workspace = served
    is_dark = workspace.dataset().meta.plan.record is Recording.STATES
    scene = workspace.dataset()[0].meta.job.scene
    asked: set[str] = set()
    own, scheme = (360, "dark") if is_dark else (1400, "light")
    with tab(browser, client, own, scheme) as page:
        page.on("request", lambda request: asked.add(urlsplit(request.url).path))
        for path in (path.format(scene=scene) for path in _PAGES):
            page.goto(client.url + path)
            if path == "/statistics":
                page.wait_for_selector("section.figures", timeout=300_000)
            assert axe_violations(page) == [], path
            for width in (*_WIDTHS_PX, own):
                page.set_viewport_size({"width": width, "height": 900})
                assert overflow_px(page) <= 0, (path, width)
        for path in (path.format(scene=scene) for path in _FILES):
            assert page.request.get(client.url + path).status == 200, path
            asked.add(path)
    view = Recent(lambda: read_view(workspace), 0.0)
    assert {route.path for route in all_routes(view) if not any(answers(route, path) for path in asked)} == set()


def answers(route: Any, path: str) -> bool:
    """Returns whether a route serves a path, or accepts no GET: such routes process forms and have a different test."""
    scope = {"type": "http", "method": "GET", "path": path, "root_path": "", "headers": []}
    return route.matches(scope)[0] is Match.FULL or "GET" not in (getattr(route, "methods", None) or {"GET"})


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


def test_one_slider_moves_two_episodes_of_different_length(browser, recordings):
    dataset = Dataset(recordings[Recording.STATES])
    by_length = sorted(dataset, key=len)
    short, long = by_length[0].episode_id, by_length[-1].episode_id
    ends = len(dataset[short]) - 1, len(dataset[long]) - 1
    assert ends[0] < ends[1]
    with web_page(recordings[Recording.STATES]) as client, tab(browser, client, 390) as page:
        page.goto(f"{client.url}/episodes/{short}")
        assert long in page.locator("#choices option").evaluate_all("all => all.map(one => one.value)")
        page.fill("#beside [name=second]", long)
        page.click("#beside button")
        page.wait_for_url(f"**/pair?first={short}&second={long}")
        sides = page.locator("#player .side")
        boxes = [sides.nth(place).bounding_box() for place in range(2)]
        assert boxes[1]["y"] >= boxes[0]["y"] + boxes[0]["height"]  # stacked on a phone
        page.set_viewport_size({"width": 1400, "height": 900})
        boxes = [sides.nth(place).bounding_box() for place in range(2)]
        assert boxes[0]["y"] == boxes[1]["y"]
        for t in (0, 1, ends[1]):
            page.locator("#time").evaluate("(time, t) => {time.value = t; time.dispatchEvent(new Event('input'))}", t)
            page.wait_for_selector(f'#player[data-t="{t}"]')
            for place, (name, end) in enumerate(zip((short, long), ends, strict=True)):
                step, side = min(t, end), sides.nth(place)
                ended = ", ended" if step < t else ""
                assert side.locator("output").text_content().strip() == f"step {step} of {end}{ended}"
                assert (
                    side.locator("img").get_attribute("src").removeprefix(client.url)
                    == f"/episodes/{name}/frames/{step}.png?kind=rgb"
                )
                x, y = (float(value) for value in dataset[name].poses[step, :2])
                turned = side.locator(".robot").get_attribute("transform")
                moved = [float(value) for value in re.match(r"translate\((\S+) (\S+)\)", turned).groups()]
                assert moved == pytest.approx([x, -y], abs=1e-3)
        page.click("#play")
        page.wait_for_selector('#play[aria-pressed="false"]')
        assert page.locator("#time").input_value() == str(ends[1])


def test_without_scripts_two_episodes_show_the_frames_of_one_time(client):
    text = client.ask("/pair?first=ep_000001&second=ep_000003&t=1").text
    for name in ("ep_000001", "ep_000003"):
        assert f"/episodes/{name}/frames/1.png?kind=rgb" in text
    assert "navigation error: planar distance" in text
    assert client.ask("/pair?first=ep_000001").status == 400
    assert "needs two episodes" in client.ask("/pair").text
    assert client.ask("/pair?first=ep_000001&second=ep_99").status == 404


def test_states_play_in_small_frames_and_a_paused_player_shows_the_frames_of_the_dataset(browser, recordings):
    episode = Dataset(recordings[Recording.STATES])[0]
    expected = {
        "rgb": lambda t: episode.rgb(t),
        "depth": lambda t: show_depth(episode.depth(t)),
        "ids": lambda t: show_ids(episode.ids(t), episode.meta.target_instance_id),
    }

    def check_paused_frame(page: Any) -> int:
        page.wait_for_function(_ARE_WHOLE)
        t = int(page.locator("#player").get_attribute("data-t"))
        for kind, image in expected.items():
            assert page.evaluate(_SHOWN, kind) == hashlib.sha256(image(t).tobytes()).hexdigest(), (kind, t)
        return t

    with web_page(recordings[Recording.STATES]) as client, tab(browser, client) as page:
        asked: list[str] = []
        page.on("request", lambda request: asked.append(urlsplit(request.url).path))
        page.goto(f"{client.url}/episodes/{episode.episode_id}")
        assert check_paused_frame(page) == 0
        assert not [path for path in asked if "/playback/" in path]
        page.evaluate(_PLAY_UNTIL_SMALL)
        played = check_paused_frame(page)
        assert [path for path in asked if path.endswith(f"/frames/{played}.png")]
        asked.clear()
        page.click("#step")
        page.wait_for_selector(f'#player:not([data-t="{played}"])')
        assert check_paused_frame(page) == played + 1
        assert not [path for path in asked if "/playback/" in path]


def test_an_episode_repeats_at_the_chosen_speed_and_the_next_one_keeps_the_settings(browser, client):
    with tab(browser, client) as page:
        page.goto(f"{client.url}/episodes/ep_000001")
        page.select_option("#speed", "4")
        page.check("#loop")
        page.click("#play")
        for t in ("11", "0", "11"):
            page.wait_for_selector(f'#player[data-t="{t}"]')
        page.uncheck("#loop")
        page.wait_for_selector('#play[aria-pressed="false"]')
        assert page.locator("#player").get_attribute("data-t") == "11"
        page.check("#loop")
        with page.expect_navigation():
            page.click("a[rel=next]")
        assert page.url.endswith("/episodes/ep_000002")
        assert (page.locator("#speed").input_value(), page.locator("#loop").is_checked()) == ("4", True)
        assert page.locator("a[rel=prev]").get_attribute("href") == "/episodes/ep_000001"


def test_the_outline_surrounds_the_target_on_the_colour_image(browser, client, data):
    episode = Dataset(data)["ep_000001"]
    mask = episode.ids(0) == episode.meta.target_instance_id
    with tab(browser, client) as page:
        page.goto(f"{client.url}/episodes/ep_000001")
        assert not page.locator("#outline").is_visible()
        page.check("#outlined")
        page.wait_for_selector("#outline[data-target]")
        drawn = np.array(page.evaluate(_DRAWN)).reshape(mask.shape)
        image, border = (page.locator(name).bounding_box() for name in ("img[data-kind=rgb]", "#outline"))
    assert image == border
    assert 0 < drawn.sum() < mask.sum()
    assert not (drawn & ~mask).any()
    inside = mask[1:-1, 1:-1] & ~(mask[:-2, 1:-1] & mask[2:, 1:-1] & mask[1:-1, :-2] & mask[1:-1, 2:])
    assert drawn[1:-1, 1:-1][inside].all()  # all pixels of the target beside another object


@pytest.mark.parametrize("path", ["/", "/episodes/ep_000001"])
def test_a_phone_shows_picture_and_instruction_without_scrolling(browser, client, data, path):
    with tab(browser, client, width=390) as page:
        page.goto(client.url + path)
        for found in (page.locator("main img").first, page.get_by_text(Dataset(data)[0].instruction).first):
            box = found.bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= 390
            assert box["y"] + box["height"] <= 844


def test_a_phone_shows_the_instructions_of_the_table_without_scrolling_to_the_side(browser, client, data):
    with tab(browser, client, width=390) as page:
        page.goto(f"{client.url}/episodes")
        box = page.locator("td.text").first.bounding_box()
        assert 0 <= box["x"] < box["x"] + box["width"] <= 390


def test_the_object_below_the_pointer_is_named_and_a_note_is_stored(browser, client, data):
    with tab(browser, client) as page:
        page.goto(f"{client.url}/episodes/ep_000001")
        page.hover("img[data-kind=ids]")
        page.wait_for_selector("#object:not(:empty)")
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
        page.click("text=30 steps forward")
        assert page.locator("img[data-kind=rgb]").get_attribute("alt") == "colour at step 11"
        page.click("nav >> text=Farm")
        assert "Archived episodes" in page.locator("main").inner_text()


def test_the_keyboard_reaches_content_rows_and_the_player(browser, client):
    with tab(browser, client) as page:
        page.goto(f"{client.url}/episodes")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.textContent") == "Skip to content"
        page.keyboard.press("Enter")
        assert page.url.endswith("#main")
        page.focus("th a")
        with page.expect_navigation():
            page.keyboard.press("Enter")
        assert "order=desc" in page.url
        page.goto(f"{client.url}/episodes/ep_000001")
        page.focus("#time")
        page.keyboard.press("ArrowRight")
        page.wait_for_selector('#player[data-t="1"]')
        page.focus("#play")
        page.keyboard.press("Space")
        page.wait_for_selector('#player:not([data-t="1"])')


def robot_pixels(page: Any) -> int:
    """Returns the number of pixels of the 3D view with the colour of the robot's back or top."""
    shown = np.asarray(Image.open(io.BytesIO(page.locator("#scene3d").screenshot())).convert("RGB")).astype(int)
    red, green, blue = shown[..., 0], shown[..., 1], shown[..., 2]
    return int(np.count_nonzero((red > 100) & (red - green > 60) & (red - blue > 60)))


def test_the_3d_view_starts_behind_the_robot_and_cuts_away_what_is_in_front_of_it(browser, recordings):
    dataset = Dataset(recordings[Recording.STATES])
    hidden = []
    with web_page(recordings[Recording.STATES]) as client, tab(browser, client) as page:
        for episode in dataset:
            page.goto(f"{client.url}/scenes/{episode.summary.scene}/3d?episode={episode.episode_id}")
            page.wait_for_selector("#scene3d[data-cut]")
            away = [float(value) for value in page.locator("#scene3d").get_attribute("data-cut").split(",")]
            yaw = yaw_of(episode.poses)[0]
            assert away == pytest.approx([np.cos(yaw), np.sin(yaw)], abs=2e-3)  # the camera is behind and looks ahead
            page.keyboard.press("Tab")
            for turned in range(4):  # also from the sides and from ahead
                shown = robot_pixels(page)
                assert shown > 1000, (episode.episode_id, turned)
                page.uncheck("#clear")
                page.wait_for_selector('#scene3d[data-cut=""]')
                hidden.append(robot_pixels(page) < shown / 2)
                page.check("#clear")
                page.focus("#scene3d")
                for _ in range(16):
                    page.keyboard.press("ArrowLeft")
                page.wait_for_selector('#scene3d:not([data-cut=""])')
    assert any(hidden)  # without the cut, a wall or an object hides the robot in some view


def test_the_3d_view_draws_the_scene_and_turns_with_the_keyboard(browser, client):
    with tab(browser, client, width=400) as page:
        page.goto(f"{client.url}/scenes/office/3d?episode=ep_000001")
        page.wait_for_selector("#scene3d[data-drawn]")
        first = page.locator("#scene3d").screenshot()
        assert len(Image.open(io.BytesIO(first)).convert("RGB").getcolors(1 << 20)) > 20
        page.focus("#scene3d")
        drawn = page.locator("#scene3d").get_attribute("data-drawn")
        page.keyboard.press("ArrowLeft")
        page.wait_for_selector(f'#scene3d:not([data-drawn="{drawn}"])')
        assert page.locator("#scene3d").screenshot() != first
        page.focus("#time")
        page.keyboard.press("End")
        page.wait_for_selector('#scene3d[data-step="11"]')


@pytest.mark.parametrize("script", [True, False])
def test_without_webgl_or_javascript_the_3d_page_refers_to_the_map(browser, client, script):
    with tab(browser, client, script=script) as page:
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
        page.goto(f"{client.url}/scenes/office/3d")
        if script:
            page.wait_for_selector("#message:has-text('does not provide WebGL')")
        assert "WebGL" in page.locator("#message").inner_text()
        page.click("text=map of office")
        assert page.locator("svg.map").is_visible()


def confirm(page: Any, url: str, action: str) -> None:
    """Opens an operation from the farm page, confirms it and returns to the farm page."""
    page.click(f"#operations >> text={action}")
    page.wait_for_selector("form button")  # the click returns before the new page is loaded
    for box in page.locator("form input[type=checkbox]").all():
        box.check()
    with page.expect_navigation():
        page.click("form button")
    assert f"{action}: " in page.locator("[role=status]").inner_text()
    page.goto(url)


@pytest.mark.slow
def test_the_page_of_a_run_updates_itself_and_can_retry_an_episode_and_drain_workers(browser, tmp_path):
    settings = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=5.0)
    options = CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings)
    plan = room_plan(2, draws=1, attempts_per_draw=1)
    with (
        Coordinator(tmp_path / "out", plan, room_catalog(tmp_path), options) as coordinator,
        web_page(tmp_path / "out", administer=coordinator.administer) as client,
        WireWorker(coordinator.endpoints, coordinator.run) as worker,
        tab(browser, client) as page,
    ):
        done = page.locator("#live .meter label")
        assert done.inner_text() == "0 of 2 episodes archived"
        _, lease = worker.job()
        assert worker.fail(lease, FailReason.TIMEOUT)
        job, lease = worker.job()
        assert worker.deliver(lease, bundle_for(job))
        page.wait_for_selector("#live :text-is('1 of 2 episodes archived')")  # the page updates itself
        confirm(page, client.url, "retry")
        job, lease = worker.job()
        assert worker.deliver(lease, bundle_for(job))
        page.wait_for_selector("#live :text-is('2 of 2 episodes archived')")
        assert page.locator(".tiles").inner_text().count("finished") == 1
        confirm(page, client.url, "drain")
        assert worker.beat().drain
        assert axe_violations(page) == []
        assert page.locator("#live table").last.inner_text().splitlines()[1].split()[1] == "drain"
