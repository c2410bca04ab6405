"""A folder of datasets on one server: its list, the pages of each dataset, and the same access rules on all paths."""

from __future__ import annotations

import io
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote, unquote

import pytest
from PIL import Image

from factory.cli.main import cli
from factory.dataset.marks import read_marks
from factory.web.folder import MOST_OPEN, find_datasets
from schemas.errors import UsageError
from schemas.storage.dataset_files import METADATA_FILE
from tests.builders.archived import ArchivedRun
from tests.builders.dataset import make_dataset
from tests.builders.web import WebClient, web_folder

SECRET = "0123456789abcdef"
ODD = "two words & 50%"
NAMES = ("first", ODD)
PAGES = (
    "/",
    "/gallery",
    "/farm",
    "/episodes",
    "/episodes/ep_000001",
    "/scenes",
    "/pair?first=ep_000001&second=ep_000002",
    "/scenes/office",
    "/scenes/office/floor.svg",
    "/statistics",
    "/evaluations",
    "/operations/retry",
    "/episodes/ep_000001/thumbnail.jpg",
    "/episodes/ep_9",
)


def base(name: str) -> str:
    return f"/datasets/{quote(name, safe='')}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("folder") / "all"
    for name, episodes in zip(NAMES, (2, 3), strict=True):
        make_dataset(root / name, episodes)
    ArchivedRun(root / "half", planned=4, done=1)
    shutil.copytree(root / "first", root / "damaged")
    (root / "damaged" / METADATA_FILE).write_bytes(b"PAR1")
    (root / "empty" / "episodes").mkdir(parents=True)
    (root / "notes").mkdir()
    (root / "notes" / "todo.txt").write_text("not a dataset")
    make_dataset(root.parent / "outside", 1)
    return root


@pytest.fixture(scope="module")
def client(folder: Path) -> Iterator[WebClient]:
    with web_folder(folder) as found:
        yield found


def test_the_list_names_each_dataset_with_picture_plan_episodes_and_state(client, folder):
    assert find_datasets(folder) == ["damaged", "empty", "first", "half", ODD]
    text = client.ask("/").text
    rows = dict(re.findall(r'<a href="(/datasets/[^"]+/)">(.*?)</li>', text, re.DOTALL))
    assert set(rows) == {f"{base(name)}/" for name in find_datasets(folder)}
    assert "2 episodes · finished" in rows["/datasets/first/"]
    assert "1 of 4 episodes · incomplete" in rows["/datasets/half/"]
    assert "plan test ·" in rows["/datasets/first/"]
    for name in ("damaged", "empty"):
        assert '<span class="warning">' in rows[f"/datasets/{name}/"]
        assert name in re.search(r'"warning">(.*?)</span>', rows[f"/datasets/{name}/"], re.DOTALL)[1]
    pictures = [re.search(r'src="(/pictures/[^"]+)"', rows[f"{base(name)}/"])[1] for name in NAMES]
    for picture in pictures:
        reply = client.ask(picture)
        assert Image.open(io.BytesIO(reply.body)).size == (320, 320)
        assert "immutable" in reply.headers["cache-control"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("path", PAGES)
def test_all_links_of_a_dataset_stay_below_its_path(client, name, path):
    reply = client.ask(base(name) + path)
    assert reply.status == (404 if path.endswith("ep_9") else 200)
    if "text/html" not in reply.headers["content-type"]:
        return
    links = {link.replace("&amp;", "&") for link in re.findall(r'(?:href|src|action|data-\w+)="(/[^"]*)"', reply.text)}
    shared = {link for link in links if link in ("/", "/login") or link.startswith("/static/")}
    assert links - shared
    for link in links - shared:
        assert link.startswith(f"{base(name)}/"), link
        if (
            "/operations/" not in link
            and "/live" not in link
            and "download" not in link
            and not link.endswith(("/", "/pair"))
        ):
            assert client.ask(link).status in ((200, 404) if "ep_9" in path else (200,)), link
    current = re.findall(r'href="([^"]+)" aria-current', reply.text)
    assert current == (
        [] if path.startswith(("/operations", "/pair")) else [f"{base(name)}/{(path.split('/')[1] or 'gallery')}"]
    )


def test_each_dataset_shows_its_own_episodes(client):
    assert "2 of 2 episodes" in client.ask("/datasets/first/episodes").text
    assert "3 of 3 episodes" in client.ask(f"{base(ODD)}/episodes").text
    assert client.ask("/datasets/first/episodes/ep_000003").status == 404
    assert "1 of 4 episodes archived" in client.ask("/datasets/half/").text  # its run has not ended: the farm page
    assert METADATA_FILE in client.ask("/datasets/damaged/episodes").text


@pytest.mark.parametrize(
    "name",
    [
        *("..", ".", "../outside", "..%2foutside", "%2e%2e/outside", "%2e%2e%2foutside", "first%2f..%2f..%2foutside"),
        *("outside", "notes", "", "%00", "%ff", "first%00", "%2fetc", "first/../../outside", "a" * 3000, "{name}", "%"),
    ],
)
def test_a_name_that_is_not_listed_opens_nothing(client, name):
    for path in ("/", "/episodes", "/episodes/ep_000001", "/farm"):
        assert client.ask(f"/datasets/{name}{path}").status in (404, 414), path
    assert client.ask(f"/pictures/{name}").status in (404, 414)


def test_an_unknown_name_is_answered_with_the_nearest_one(client):
    assert "firsd" in client.ask("/datasets/firsd/").text
    assert "did you mean" in client.ask("/datasets/firsd/").text
    assert '<a href="/">All datasets</a>' in client.ask("/datasets/firsd/").text


@pytest.mark.parametrize("path", ["/", "/pictures/first", "/datasets/none/", *(base(ODD) + path for path in PAGES)])
def test_access_rules_and_headers_are_the_same_on_every_path(folder, client, path):
    headers = client.ask(path).headers
    assert "default-src 'none'" in headers["content-security-policy"]
    wanted = {"x-content-type-options": "nosniff", "cross-origin-resource-policy": "same-origin"}
    assert wanted.items() <= headers.items()
    assert client.ask(path, Host="evil.example").status == 421
    assert client.ask(f"{path.partition('?')[0]}?{'a' * 5000}").status == 414
    assert client.ask(path, "DELETE").status == 405
    assert client.ask(path, "POST", "key=x").status == 401
    assert client.ask(path, "POST", "key=x", Cookie=client.cookie(), Origin="http://evil.example").status == 403
    with web_folder(folder, SECRET) as guarded:
        assert guarded.ask(path).status == 303
        assert guarded.ask(path, Accept="*/*").status == 401
        assert guarded.ask(path, Authorization="Bearer wrong").status in (303, 401)
        assert guarded.ask(f"{path}{'&' if '?' in path else '?'}token=wrong").status == 401
        assert guarded.ask(path, Authorization=f"Bearer {SECRET}").status == client.ask(path).status


def test_a_change_needs_the_key_and_reaches_its_dataset_only(client, folder):
    here = f"{base(ODD)}/episodes/ep_000001"
    assert client.ask(f"{here}/mark", "POST", "flagged=1&key=wrong", Cookie=client.cookie()).status == 403
    reply = client.post(f"{here}/mark", here, flagged="1", note="dark")
    assert (reply.status, unquote(reply.headers["location"])) == (303, f"{unquote(here)}#mark")
    assert read_marks(folder / ODD / "marks.json")["ep_000001"].note == "dark"
    assert not (folder / "first" / "marks.json").exists()
    shown = client.ask(f"{base(ODD)}/episodes?flagged=1").text
    assert "dark" in shown


def test_datasets_that_appear_are_listed_and_only_a_few_stay_open(tmp_path):
    make_dataset(tmp_path / "all" / "d00", 1)
    for number in range(1, MOST_OPEN + 3):
        shutil.copytree(tmp_path / "all" / "d00", tmp_path / "all" / f"d{number:02d}")
    with web_folder(tmp_path / "all") as client:
        for _ in range(2):
            for number in range(MOST_OPEN + 3):
                assert "1 of 1 episodes" in client.ask(f"/datasets/d{number:02d}/episodes").text


def test_a_folder_without_datasets_and_options_of_one_dataset_are_refused(folder, tmp_path):
    with pytest.raises(UsageError, match="neither a dataset nor a folder of datasets"):
        cli(["serve", str(tmp_path)], standalone_mode=False)
    with pytest.raises(UsageError, match="--eval belongs to one dataset"):
        cli(["serve", str(folder), "--eval", str(folder)], standalone_mode=False)
