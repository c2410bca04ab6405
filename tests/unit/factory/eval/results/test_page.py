"""The page of an evaluation: self-contained, escaped, main metrics first."""

from __future__ import annotations

import re

from factory.eval.models.result import EvalEnd
from factory.eval.results.page import EpisodeFilm, write_page
from factory.eval.results.video import choose_failures
from tests.builders.eval_results import evaluation_of, result_of
from tests.builders.html import Outline

HOSTILE = "m:<script>alert(1)</script>"
WRITTEN = "<img src=x onerror=alert(1)>"


def failure(**changes: object) -> EpisodeFilm:
    return EpisodeFilm((result_of(1, success=False, **changes),), film=b"film", poster=b"poster")


def test_names_and_instructions_cannot_become_markup() -> None:
    hostile = evaluation_of(HOSTILE).model_copy(update={"run": HOSTILE, "source": WRITTEN, "remarks": (WRITTEN,)})
    page = write_page(hostile, {(HOSTILE,): [failure(instruction=f'"{WRITTEN}', detail="<u>")]})
    outline = Outline(page)
    assert not outline.tags & {"script", "img", "u"}
    assert "onerror" not in outline.attributes
    for text in ("&lt;script&gt;alert(1)&lt;/script&gt;", "&lt;img src=x onerror=alert(1)&gt;", "&lt;u&gt;"):
        assert text in page


def test_the_page_is_self_contained() -> None:
    page = write_page(evaluation_of("stop"), {("stop",): [failure()]})
    outline = Outline(page)
    sources = [link for link in outline.links if not link.startswith("#")]
    assert sorted(sources) == ["data:image/jpeg;base64,cG9zdGVy", "data:video/mp4;base64,ZmlsbQ=="]
    assert {link[1:] for link in outline.links if link.startswith("#")} <= set(outline.ids)
    assert "url(" not in page
    assert "default-src 'none'" in page


def test_videos_do_not_autoplay_and_can_be_paused() -> None:
    page = write_page(evaluation_of("stop", "expert"), {("stop",): [failure(), failure()], ("expert",): [failure()]})
    films = re.findall(r"<video[^>]*>", page)
    assert len(films) == 3
    for film in films:
        assert " controls" in film
        assert 'preload="none"' in film
        assert "autoplay" not in film
        assert "loop" not in film
        assert 'aria-label="Video of ep_000001, policy ' in film


def test_tables_scroll_in_containers_that_the_keyboard_reaches() -> None:
    outline = Outline(write_page(evaluation_of("expert", "stop"), {}))
    assert outline.table_parents
    for classes, attributes in outline.table_parents:
        assert "table" in classes.split()
        assert attributes["tabindex"] == "0"
        assert attributes["aria-label"]


def test_main_metrics_are_first_and_the_rest_is_collapsed() -> None:
    page = write_page(evaluation_of("expert", "stop"), {("stop",): [failure()]})
    main, rest = page.split('<section id="measures">')
    table = main[main.index("<table") :]
    assert re.findall(r'data-label="([^"]+)"', table)[:5] == ["SR, %", "SPL", "NE, m", "collision, %", "n"]
    assert "<details" not in table
    groups = ("By split", "By scene", "By tier", "By category", "By template")
    for title in ("All episodes", *groups, "Instruction ablation"):
        assert f"<details><summary><h3>{title}</h3></summary>" in rest


def test_each_table_lists_each_policy_with_its_interval() -> None:
    page = write_page(evaluation_of("expert", "stop"), {})
    for title in ("All episodes", "By split", "By scene", "By tier", "By category", "By template"):
        table = page.split(f"<h3>{title}</h3>")[1].split("</table>")[0]
        assert table.count('<th scope="row">expert</th>') == table.count('<th scope="row">stop</th>') >= 1, title
    words = page.split("<h3>Instruction ablation</h3>")[1].split("</table>")[0]
    assert words.count(">expert</th>") == words.count(">stop</th>") == 1
    assert "50.0 <small>19 to 81</small>" in page  # Wilson interval of 3 of 6
    assert "left:18.76%;width:62.48%" in page


def test_the_same_evaluation_gives_the_same_bytes() -> None:
    shown = {("stop",): [failure()]}
    assert write_page(evaluation_of("stop"), shown) == write_page(evaluation_of("stop"), shown)


def test_shown_failures_cover_every_kind() -> None:
    ends = [EvalEnd.TIMEOUT] * 6 + [EvalEnd.COLLISION] * 2 + [EvalEnd.POLICY_HUNG]
    rows = [result_of(n, success=False, end=end) for n, end in enumerate(ends, 1)] + [result_of(10)]
    rows[5] = result_of(6, success=False, target_in_view=False)
    assert [row.spec_id[-2:] for row in choose_failures(rows, 5)] == ["01", "02", "06", "07", "09"]
    assert len(choose_failures(rows, 99)) == 9
    assert choose_failures(rows, 0) == []
