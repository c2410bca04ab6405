"""The report and the evaluation page in Chromium: axe finds no violation, nothing is clipped, videos can be paused."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from factory.eval.models.result import EvalEnd
from factory.eval.policies.registry import PolicyNote
from factory.eval.results.page import EpisodeFilm, write_page
from factory.eval.results.score import score_policy
from factory.eval.results.video import draw_poster
from factory.report import render_report
from factory.report.figures import attempts, categories, samples
from factory.report.gather import gather
from factory.report.make import PAGE_FILE
from factory.visualize.film import write_mp4
from tests.builders.browser import axe_violations, chromium, opened, overflow_px, why_no_chromium
from tests.builders.dataset import make_dataset
from tests.builders.eval_results import evaluation_of, result_of

REASON = why_no_chromium()
pytestmark = pytest.mark.skipif(bool(REASON), reason=REASON)

WIDTHS = (400, 800, 1400)
NAMES = ("report", "evaluation")
_LONG = "my_package.my_module:APolicyWithALongNameWithoutAnySpace"
_STICKS_OUT = """
[...document.querySelectorAll("body *:not(svg *)")]
  .filter(element => !element.closest(".table") && element.getBoundingClientRect().right > innerWidth + 0.5)
  .map(element => element.outerHTML.slice(0, 120))
"""
_LUMINANCE = """
["backgroundColor", "color"].map(name => getComputedStyle(document.documentElement)[name]
  .match(/[0-9.]+/g).slice(0, 3).map(Number).reduce((sum, part) => sum + part))
"""
_PLAY = """
async film => {
  await film.play();
  await new Promise(done => film.addEventListener("timeupdate", done, {once: true}));
  film.pause();
  return film.paused;
}
"""


def write_evaluation(folder: Path) -> str:
    """Writes the page of an incomplete evaluation with a failing policy, ablated instructions and a video."""
    evaluation = evaluation_of("expert", _LONG)
    raised = result_of(1, success=False, end=EvalEnd.POLICY_RAISED, detail="ValueError: " + "x" * 200)
    note = PolicyNote(policy="m:P", knows="camera", reads_instruction=True, renderer="", software={})
    policies = (*evaluation.policies, score_policy("m:P", [raised], note))
    pictures = [np.full((320, 640, 3), 6 * n, np.uint8) for n in range(36)]
    write_mp4(folder / "film.mp4", pictures, Fraction(8), 28)
    failed = EpisodeFilm((raised,), (folder / "film.mp4").read_bytes(), draw_poster(pictures[-1]))
    partial = evaluation.model_copy(update={"policies": policies, "complete": False})
    return write_page(partial, {("expert",): [failed], (_LONG,): [failed] * 3})


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pages")
    make_dataset(folder / "data", 3, planned=4)
    files, _ = render_report(gather(folder / "data"), draw_functions=(samples.draw, categories.draw, attempts.draw))
    texts = {"report": files[PAGE_FILE].decode(), "evaluation": write_evaluation(folder)}
    found = {name: folder / f"{name}.html" for name in NAMES}
    for name, text in texts.items():
        found[name].write_text(text, encoding="utf-8")
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", NAMES)
def test_axe_finds_no_violation_and_nothing_is_cut_off(
    browser: Any, pages: dict[str, Path], name: str, width: int, scheme: str
) -> None:
    with opened(browser, pages[name], width, scheme) as page:
        assert overflow_px(page) <= 0
        page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true })")
        assert overflow_px(page) <= 0
        assert page.evaluate(_STICKS_OUT) == []
        assert axe_violations(page) == []


@pytest.mark.parametrize("name", NAMES)
def test_pages_follow_the_colour_scheme(browser: Any, pages: dict[str, Path], name: str) -> None:
    grounds = {}
    for scheme in ("light", "dark"):
        with opened(browser, pages[name], 800, scheme) as page:
            ground, ink = page.evaluate(_LUMINANCE)
            grounds[scheme] = ground > ink
    assert grounds == {"light": True, "dark": False}


@pytest.mark.parametrize("width", WIDTHS)
def test_main_metrics_need_no_scrolling(browser: Any, pages: dict[str, Path], width: int) -> None:
    with opened(browser, pages["evaluation"], width, "light") as page:
        table = page.locator(".table.main")
        assert table.evaluate("element => element.scrollWidth - element.clientWidth") <= 0


def test_axe_itself_finds_a_table_that_the_keyboard_does_not_reach(
    browser: Any, pages: dict[str, Path], tmp_path: Path
) -> None:
    broken = tmp_path / "broken.html"
    broken.write_text(pages["evaluation"].read_text(encoding="utf-8").replace(' tabindex="0"', ""), encoding="utf-8")
    with opened(browser, broken, 400, "light") as page:
        page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true })")
        assert "scrollable-region-focusable" in {rule for rule, _ in axe_violations(page)}


def test_a_film_plays_and_can_be_paused(browser: Any, pages: dict[str, Path]) -> None:
    with opened(browser, pages["evaluation"], 800, "light") as page:
        film = page.locator("video").first
        assert film.evaluate("film => film.paused")
        assert film.evaluate(_PLAY)
        assert film.evaluate("film => film.currentTime") < film.evaluate("film => film.duration")
