"""Figures of the statistics page: a separate process draws them while the page stays responsive; they are cached."""

from __future__ import annotations

import os
import re

from factory.dataset.reader import Dataset
from factory.report.figures.registry import DRAW_FUNCTIONS
from factory.report.gather import gather
from factory.support.settings import cache_directory
from factory.web.figures.process import draw_statistics
from factory.web.figures.store import StatisticsStore
from tests.builders.dataset import make_dataset
from tests.builders.web import WebClient, web_page
from tests.builders.wire_worker import until


def wait_for_figures(client: WebClient) -> str:
    until(lambda: '<section id="tiers" class="figures">' in client.ask("/statistics").text, 300)
    return client.ask("/statistics").text


def test_the_page_answers_while_the_figures_are_drawn_and_the_next_server_shows_them_from_the_cache(tmp_path):
    data = tmp_path / "data"
    make_dataset(data, 3)
    with web_page(data) as client:
        first = client.ask("/statistics")
        assert (first.status, "The figures are being drawn" in first.text) == (200, True)
        images = re.findall(r'<img src="(/statistics/[^"]+)"', wait_for_figures(client))
        assert len(images) >= len(DRAW_FUNCTIONS) - 2  # no figure of samples or failed attempts
        for path in images:
            assert client.ask(path).headers["content-type"].startswith("image/svg+xml"), path
        os.utime(data / "metadata.parquet")
        until(lambda: "The dataset has changed" in client.ask("/statistics").text)
        assert '<section id="tiers" class="figures">' in client.ask("/statistics").text
    cached = {path: path.stat().st_mtime_ns for path in (cache_directory() / "statistics").iterdir()}
    with web_page(data) as client:
        wait_for_figures(client)
    assert {path: path.stat().st_mtime_ns for path in (cache_directory() / "statistics").iterdir()} == cached


def test_the_figures_of_a_large_dataset_are_first_drawn_from_some_of_its_episodes(tmp_path):
    make_dataset(tmp_path / "data", 3)
    progress: list[tuple[int, int]] = []
    parts = list(draw_statistics(tmp_path / "data", lambda done, total: progress.append((done, total)), 1))
    assert [(part.opened, part.episodes, part.is_complete) for part in parts] == [(1, 3, False), (3, 3, True)]
    assert progress == [(1, 1), (1, 3), (2, 3), (3, 3)]
    captions = [draw(gather(tmp_path / "data", samples=0)).caption for draw in DRAW_FUNCTIONS[1:]]
    assert [card.caption for card in parts[1].cards] == [text for text in captions if "No " not in text[:3]]
    assert list(draw_statistics(tmp_path / "data", lambda _done, _all: None, 1)) == parts[1:]


def test_the_figures_of_a_changed_dataset_are_drawn_again_only_after_a_pause(tmp_path):
    now_s = 0.0

    def clock() -> float:
        nonlocal now_s
        now_s += 1.0
        return now_s

    first, changed = Dataset.__new__(Dataset), Dataset.__new__(Dataset)
    with StatisticsStore(str(tmp_path / "none"), clock) as store:
        assert store.of(first).is_drawing
        until(lambda: not store.of(first).is_drawing, 300)
        assert "is not a dataset" in store.of(first).trouble
        waiting = store.of(changed)
        assert (waiting.is_drawing, waiting.wait_s > 0, waiting.trouble) == (False, True, store.of(first).trouble)
        now_s += waiting.wait_s
        assert store.of(changed).is_drawing
