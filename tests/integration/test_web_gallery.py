"""The home page of a finished dataset is a gallery with thumbnails, which are rendered once."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from factory.dataset.reader import Dataset
from factory.web.pages.gallery import PAGE_CARDS
from factory.web.thumbnails import THUMBNAIL_PX, ThumbnailStore, draw_thumbnail
from schemas.terms import Recording
from tests.builders.archived import ArchivedRun
from tests.builders.dataset import make_dataset
from tests.builders.web import WebClient, web_page


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("gallery") / "data"
    make_dataset(root, PAGE_CARDS + 2)
    return root


@pytest.fixture(scope="module")
def client(data: Path) -> Iterator[WebClient]:
    with web_page(data) as found:
        yield found


def cards(text: str) -> list[str]:
    return re.findall(r'<li><a href="/episodes/(ep_\d+)"><img src="/episodes/\1/thumbnail.jpg\?of=', text)


def test_a_finished_dataset_opens_with_pictures_and_instructions(client, data):
    home = client.ask("/").text
    assert cards(home) == [f"ep_{number:06d}" for number in range(1, PAGE_CARDS + 1)]
    first = Dataset(data)[0].summary
    assert f"<span>{first.instruction}</span>" in home
    assert f"ep_000001 · {first.scene} · {first.spawn_tier} · {first.num_steps} steps" in home
    assert '<a href="/gallery" aria-current=page>' in home
    assert f"{PAGE_CARDS + 2} episodes" in home
    assert cards(client.ask("/gallery?page=1").text) == ["ep_000025", "ep_000026"]
    assert cards(client.ask("/gallery?sort=num_steps&order=desc").text)[0] != ""


def test_the_gallery_and_the_table_link_to_each_other_with_the_same_filters(client):
    assert 'href="/gallery?q=chair"' in client.ask("/episodes?q=chair").text
    assert 'href="/episodes?q=chair"' in client.ask("/gallery?q=chair&page=1").text
    assert "No episode matches" in client.ask("/gallery?q=nothing+of+this").text
    assert client.ask("/gallery?colour=red").status == 400


def test_a_running_dataset_opens_with_the_farm_page_and_a_finished_one_keeps_it_at_its_address(tmp_path):
    with web_page(ArchivedRun(tmp_path / "running", planned=2, done=1).root) as client:
        assert "1 of 2 episodes archived" in client.ask("/").text
        assert cards(client.ask("/gallery").text) == ["ep_000001"]
    with web_page(ArchivedRun(tmp_path / "finished", planned=2, done=2).root) as client:
        assert cards(client.ask("/").text) == ["ep_000001", "ep_000002"]
        assert "2 of 2 episodes archived" in client.ask("/farm").text


def test_browsers_keep_a_thumbnail_whose_url_names_its_content(client, data):
    url = re.findall(r'src="(/episodes/ep_000002/thumbnail[^"]+)"', client.ask("/").text)[0]
    assert url in client.ask("/episodes").text
    reply = client.ask(url)
    assert reply.headers["content-type"] == "image/jpeg"
    assert reply.headers["cache-control"] == "private, max-age=31536000, immutable"
    assert "immutable" not in client.ask("/episodes/ep_000002/thumbnail.jpg").headers["cache-control"]
    shown = np.asarray(Image.open(io.BytesIO(reply.body)))
    assert shown.shape == (THUMBNAIL_PX, THUMBNAIL_PX, 3)
    first = Dataset(data)["ep_000002"].rgb(0)
    assert np.abs(shown - first.reshape(THUMBNAIL_PX, 2, THUMBNAIL_PX, 2, 3).mean((1, 3))).mean() < 3
    missing = client.ask("/episodes/ep_000099/thumbnail.jpg")
    assert (missing.status, "the nearest one is ep_000026" in missing.text) == (404, True)


def test_the_table_of_another_dataset_has_other_urls(client, tmp_path):
    make_dataset(tmp_path / "data", 1)
    pattern = r'src="(/episodes/ep_000001/thumbnail[^"]+)"'
    with web_page(tmp_path / "data") as other:
        assert re.findall(pattern, other.ask("/").text) != re.findall(pattern, client.ask("/").text)


@pytest.mark.parametrize("record", list(Recording))
def test_a_thumbnail_is_rendered_once(record, data, recordings, monkeypatch):
    root = data if record is Recording.FRAMES else recordings[record]
    dataset, drawn = Dataset(root), []
    name = dataset[0].episode_id

    def draw(episode):
        drawn.append(episode.episode_id)
        return draw_thumbnail(episode)

    monkeypatch.setattr("factory.web.thumbnails.draw_thumbnail", draw)
    store = ThumbnailStore()
    asked = [store.encoded(dataset[name]) for _ in range(3)]
    assert len({future.result() for future in asked}) == 1
    assert store.encoded(dataset[name]).result() == asked[0].result()
    assert drawn == [name]


def test_the_cache_of_thumbnails_is_bounded_and_an_error_is_not_kept(data, monkeypatch):
    drawn: list[str] = []

    def draw(episode):
        drawn.append(episode.episode_id)
        if len(drawn) == 1:
            raise OSError("no graphics")
        return np.zeros((8, 8, 3), np.uint8)

    monkeypatch.setattr("factory.web.thumbnails.draw_thumbnail", draw)
    dataset, store = Dataset(data), ThumbnailStore(most_bytes=1)
    with pytest.raises(OSError, match="no graphics"):
        store.encoded(dataset["ep_000001"]).result()
    for name in ("ep_000001", "ep_000001", "ep_000002", "ep_000001"):
        store.encoded(dataset[name]).result()
    assert drawn == ["ep_000001", "ep_000001", "ep_000002", "ep_000001"]
