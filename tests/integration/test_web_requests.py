"""Requests to the web page: content without a browser, operations on a run, and attacks that must change nothing."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.dataset.marks import Mark, read_marks
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.visualize.panels import show_depth, show_ids
from factory.web.pages.status import routes as status_routes
from factory.web.start import serve
from schemas.errors import UsageError, WorldError
from schemas.terms import FailReason, Split
from tests.builders.archived import ArchivedRun
from tests.builders.dataset import make_dataset
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.web import WebClient, web_page
from tests.builders.wire_worker import WireWorker, bundle_for, until

PAGES = (
    "/",
    "/gallery",
    "/farm",
    "/episodes",
    "/episodes/ep_000001",
    "/scenes",
    "/scenes/office",
    "/statistics",
    "/operations/retry",
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("web") / "data"
    make_dataset(root, 3, planned=4, splits=(Split.TRAIN_ID, Split.VAL_ID))
    return root


@pytest.fixture(scope="module")
def client(data: Path) -> Iterator[WebClient]:
    with web_page(data) as found:
        yield found


def pixels(data: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(data)))


@pytest.mark.parametrize("path", PAGES)
def test_pages_need_no_script_and_no_other_server(client, path):
    reply = client.ask(path)
    assert reply.status == 200
    assert not re.findall(r'(?:src|href|action)="(?:https?:)?//', reply.text)
    assert not re.findall(r"<style|style=|javascript:|<script(?! src=\"/static/)| on[a-z]+=", reply.text)
    assert "default-src 'none'" in reply.headers["content-security-policy"]


def test_shown_frames_equal_those_of_the_dataset(client, data):
    frame = Dataset(data)["ep_000002"].frame(1)
    target = Dataset(data)["ep_000002"].meta.target_instance_id
    here = "/episodes/ep_000002/frames/1.png"
    assert np.array_equal(pixels(client.ask(here).body), frame.rgb)
    assert np.array_equal(pixels(client.ask(f"{here}?kind=depth").body), show_depth(frame.depth))
    assert np.array_equal(pixels(client.ask(f"{here}?kind=ids").body), show_ids(frame.ids, target))


def test_images_for_playback_have_a_quarter_of_the_pixels(client, data):
    frame, here = Dataset(data)["ep_000002"].frame(1), "/episodes/ep_000002/playback/1"
    target = Dataset(data)["ep_000002"].meta.target_instance_id
    colour = client.ask(here)
    assert colour.headers["content-type"] == "image/jpeg"
    assert np.abs(pixels(colour.body) - frame.rgb[::2, ::2].astype(int)).mean() < 3
    assert np.array_equal(pixels(client.ask(f"{here}?kind=depth").body), show_depth(frame.depth[::2, ::2]))
    assert np.array_equal(pixels(client.ask(f"{here}?kind=ids").body), show_ids(frame.ids[::2, ::2], target))


def test_the_colours_of_the_ids_have_the_names_of_the_objects(client, data):
    names = json.loads(client.ask("/episodes/ep_000001/objects.json").text)
    assert "chair_1 (chair)" in names.values()
    shown = pixels(client.ask("/episodes/ep_000001/frames/0.png?kind=ids").body).reshape(-1, 3)
    assert {",".join(map(str, colour)) for colour in np.unique(shown, axis=0).tolist()} - {"0,0,0"} <= set(names)


@pytest.mark.parametrize("kind", ["mp4", "mcap", "zip"])
def test_downloads_are_made_by_the_exporters(client, data, kind):
    reply = client.ask(f"/episodes/ep_000001/download/{kind}")
    assert reply.status == 200
    assert f'filename="ep_000001.{kind}"' in reply.headers["content-disposition"]
    magic = {"mp4": b"ftyp", "mcap": b"MCAP", "zip": (data / "episodes" / "ep_000001.zip").read_bytes()[:40]}[kind]
    assert magic in reply.body[:40]


def test_an_unknown_episode_is_not_found_and_the_nearest_one_is_named(client):
    for path in ("/episodes/ep_000099", "/episodes/ep_000099/frames/0.png", "/episodes/ep_000099/mask.svg"):
        assert client.ask(path).status == 404
    assert "the nearest one is ep_000003" in client.ask("/episodes/ep_000099").text
    assert client.ask("/episodes/%F0%9F%A4%96%22%3Cb%3E").status == 404
    assert client.ask("/episodes/ep_000001/frames/12345.png").status == 404
    assert client.ask("/episodes/ep_000001/frames/0.png?kind=thermal").status == 400


def test_filters_are_part_of_the_url(client):
    text = client.ask("/episodes?split=val_id&sort=num_steps&order=desc").text
    assert re.findall(r'href="/episodes/(ep_\d+)"', text) == ["ep_000002"]
    assert "<option selected>val_id</option>" in text
    assert client.ask("/episodes?colour=red").status == 400


@pytest.mark.parametrize(("success", "place"), [("centroid", "centroid"), ("surface", "footprint")])
def test_the_table_shows_the_error_that_decides_about_success_and_defines_it(tmp_path, success, place):
    make_dataset(tmp_path / "data", 1)
    path = tmp_path / "data" / "dataset_meta.json"
    meta = json.loads(path.read_text())
    meta["plan"]["task"]["success"] = success
    path.write_text(json.dumps(meta))
    row = Dataset(tmp_path / "data")[0].summary
    error = row.final_ne_m if success == "centroid" else row.final_surface_m
    with web_page(tmp_path / "data") as client:
        text = client.ask("/episodes").text
        assert f">NE to the {place}, m</a>" in text
        assert f"planar distance from the robot to the {place} of the target" in text
        assert ("–" if error is None else f"{error:.2f}") in re.findall(r"<td class=n>([^<]+)</td>", text)[-1]
        column = "final_ne_m" if success == "centroid" else "final_surface_m"
        assert client.ask(f"/episodes?sort={column}&order=desc").status == 200
        facts = client.ask("/episodes/ep_000001").text
        assert "<dt>NE to the centroid</dt>" in facts
        assert "<dt>NE to the footprint</dt>" in facts


def test_flags_and_notes_are_stored_only_with_the_key_of_the_form(data, tmp_path):
    make_dataset(tmp_path / "data", 2)
    with web_page(tmp_path / "data") as client:
        here = "/episodes/ep_000001"
        assert client.post(f"{here}/mark", here, flagged="1", note="blurred <b>").status == 303
        assert read_marks(tmp_path / "data" / "marks.json") == {"ep_000001": Mark(flagged=True, note="blurred <b>")}
        assert "blurred &lt;b&gt;" in client.ask(here).text
        assert "ep_000001" in client.ask("/episodes?flagged=1").text
        assert "ep_000002" not in client.ask("/episodes?flagged=1").text
        cookie, before = client.cookie(), (tmp_path / "data" / "marks.json").read_bytes()
        assert client.ask(f"{here}/mark", "POST", "note=x").status == 401
        assert client.ask(f"{here}/mark", "POST", "note=x", Cookie=cookie).status == 403
        assert client.ask(f"{here}/mark", "POST", "note=x&key=0", Cookie=cookie).status == 403
        own = {"Cookie": cookie, "Origin": "http://evil.example"}
        assert client.ask(f"{here}/mark", "POST", "note=x", **own).status == 403
        assert client.ask(f"{here}/mark", "POST", "note=x", Cookie=cookie, Sec_Fetch_Site="cross-site").status == 403
        assert client.post("/episodes/ep_000077/mark", here, note="x").status == 404
        assert client.post(f"{here}/mark", here, note="x" * 2001).status == 400
        assert (tmp_path / "data" / "marks.json").read_bytes() == before


def test_a_dataset_without_tables_has_a_farm_page_that_names_the_error(tmp_path):
    run = ArchivedRun(tmp_path / "run", planned=2, done=1, misses=1)
    (run.root / "metadata.parquet").unlink()
    with web_page(run.root) as client:
        assert "1 of 2 episodes archived" in client.ask("/").text
        assert "timeout" in client.ask("/").text
        reply = client.ask("/episodes")
        assert reply.status == 503
        assert "metadata.parquet is missing" in reply.text
    (run.root / "ledger.db").write_bytes(b"no ledger")
    with web_page(run.root) as client:
        assert "No ledger" in client.ask("/").text


def test_a_damaged_episode_is_named_and_the_others_are_shown(tmp_path):
    make_dataset(tmp_path / "data", 2)
    (tmp_path / "data" / "episodes" / "ep_000001.zip").write_bytes(b"damaged")
    with web_page(tmp_path / "data") as client:
        reply = client.ask("/episodes/ep_000001")
        assert reply.status == 503
        assert "ep_000001.zip is damaged" in reply.text
        assert client.ask("/episodes/ep_000002").status == 200
        assert client.ask("/episodes/ep_000002/frames/0.png").status == 200


@pytest.fixture
def coordinator(tmp_path: Path) -> Iterator[Coordinator]:
    settings = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=1.0)
    options = CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings)
    plan = room_plan(2, draws=1, attempts_per_draw=1)
    with Coordinator(tmp_path / "out", plan, room_catalog(tmp_path), options) as found:
        yield found


@pytest.fixture
def farm(coordinator: Coordinator, tmp_path: Path) -> Iterator[WebClient]:
    more = status_routes(coordinator.health)
    with web_page(tmp_path / "out", administer=coordinator.administer, more_routes=more) as found:
        yield found


def operate(farm: WebClient, action: str, **fields: str) -> str:
    reply = farm.post(f"/operations/{action}", f"/operations/{action}", confirm="1", **fields)
    assert reply.status == 200
    return reply.text


def test_a_run_is_paused_resumed_retried_and_drained_from_the_page(coordinator, farm):
    with WireWorker(coordinator.endpoints, coordinator.run) as worker:
        assert "pause: done" in operate(farm, "pause")
        assert worker.claim().job is None
        assert "The run is paused" in farm.ask("/").text
        operate(farm, "resume")
        _, lease = worker.job()
        assert worker.fail(lease, FailReason.TIMEOUT)
        until(lambda: coordinator.progress().jobs["failed"] == 1)
        assert "retry: 1 changed (ep_000001)" in operate(farm, "retry", all="1")
        for _ in range(2):
            job, lease = worker.job()
            assert worker.deliver(lease, bundle_for(job))
        until(lambda: coordinator.progress().jobs["archived"] == 2)
        assert "2 of 2 episodes archived" in farm.ask("/").text
        operate(farm, "drain")
        assert worker.beat().drain
    page = farm.ask("/").text
    assert re.findall(r"<td>(pause|resume|retry|drain)</td>", page) == ["drain", "retry", "resume", "pause"]


def test_an_operation_needs_a_confirmation_and_a_selection(coordinator, farm):
    assert farm.post("/operations/cancel", "/operations/cancel", all="1").status == 400
    assert farm.post("/operations/cancel", "/operations/cancel", confirm="1").status == 400
    both = {"confirm": "1", "all": "1", "episodes": "1"}
    assert farm.post("/operations/cancel", "/operations/cancel", **both).status == 400
    assert farm.ask("/operations/erase").status == 404
    assert coordinator.progress().jobs["pending"] == 2
    assert "refused: ep_000007" in operate(farm, "cancel", episodes="1,7")
    assert coordinator.progress().jobs["cancelled"] == 1


def test_status_pages_are_served_beside_the_web_page(farm):
    assert farm.ask("/healthz").text == "ok\n"
    assert farm.ask("/readyz").text == "ready\n"
    assert "minivla_episodes_planned 2.0" in farm.ask("/metrics").text


def test_tabs_receive_the_page_when_it_has_changed(coordinator, farm):
    host, port = farm.host.split(":")
    with socket.create_connection((host, int(port)), timeout=60) as tab:
        tab.sendall(b"GET /live HTTP/1.1\r\nHost: localhost\r\n\r\n")
        received = b""
        while b"0 of 2 episodes archived" not in received:
            received += tab.recv(65536)
        operate(farm, "pause")
        while b"The run is paused" not in received:
            received += tab.recv(65536)
    assert b"text/event-stream" in received


@pytest.mark.parametrize(
    ("path", "method", "headers", "status"),
    [
        ("/", "GET", {"Host": "evil.example"}, 421),
        ("/", "GET", {"Host": "localhost.evil.example"}, 421),
        ("/?token=wrong", "GET", {}, 401),
        ("/", "DELETE", {}, 405),
        ("/episodes", "OPTIONS", {}, 405),
        ("/episodes?q=" + "a" * 5000, "GET", {}, 414),
        ("/static/../app.py", "GET", {}, 404),
        ("/static/%2e%2e/app.py", "GET", {}, 404),
        ("/static/..%2fapp.py", "GET", {}, 404),
        ("/scenes/..%2f..%2fdataset_meta.json", "GET", {}, 404),
        ("/episodes/..%2fep_000001", "GET", {}, 404),
        ("/scenes/office/floor.svg?view=1,2,3,inf", "GET", {}, 400),
        ("/operations/cancel", "POST", {}, 401),
        ("/operations/cancel", "POST", {"Authorization": "Bearer wrong"}, 401),
        ("/login", "POST", {"Content-Length": "9999999999"}, 413),
    ],
)
def test_hostile_requests_are_refused(client, path, method, headers, status):
    assert client.ask(path, method, **headers).status == status


def test_the_server_accepts_the_token_in_a_bearer_header(client):
    assert client.ask("/login", "POST", "token=wrong").status == 401
    assert client.ask("/login", "POST", f"token={client.token}").status == 303
    reply = client.ask("/operations/pause", "POST", "", Authorization=f"Bearer {client.token}")
    assert reply.status == 400
    assert "Confirm" in reply.text


def test_reading_requires_the_token_if_the_user_has_chosen_one(data):
    token = "0123456789abcdef"
    with serve(site_of(str(data)), "127.0.0.1:0", token) as url:
        client = WebClient(url.removeprefix("http://"), token)
        assert client.ask("/").status == 303
        assert client.ask("/episodes/ep_000001/frames/0.png", Accept="image/png").status == 401
        assert client.ask("/", Cookie=client.cookie()).status == 200
        assert token not in url


def test_other_addresses_require_a_token(data):
    with pytest.raises(UsageError, match="reachable from other machines"), serve(site_of(str(data)), "0.0.0.0:0", None):
        pass


def test_an_occupied_port_is_named_with_the_remedy(client, data):
    in_use = pytest.raises(WorldError, match="give another address with --http")
    with in_use, serve(site_of(str(data)), client.host, None):
        pass


def test_slow_and_silent_clients_are_disconnected_and_do_not_block_others(client):
    host, port = client.host.split(":")
    clients = [socket.create_connection((host, int(port)), timeout=60) for _ in range(50)]
    for slow in clients[:25]:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\nX-Slow: ")
    assert client.ask("/").status == 200
    end = time.monotonic() + 50
    for slow in clients:
        with contextlib.suppress(ConnectionError):
            assert slow.recv(1000)[:12] in (b"", b"HTTP/1.1 400")
        slow.close()
    assert time.monotonic() < end


def test_many_requests_are_answered_and_change_nothing(client, data):
    before = {path: path.stat().st_mtime_ns for path in data.rglob("*")}
    for number in range(300):
        assert client.ask(f"/nothing/{number}").status == 404
    assert client.ask("/").status == 200
    assert {path: path.stat().st_mtime_ns for path in data.rglob("*")} == before


def test_a_download_without_its_package_is_answered_with_a_page_that_names_the_command(client, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "rerun" else found(name, *rest)
    )
    here = "/episodes/ep_000001"
    reply = client.ask(f"{here}/download/rerun")
    assert (reply.status, reply.headers["content-type"]) == (503, "text/html; charset=utf-8")
    for text in (reply.text, client.ask(here).text):
        assert "the download rerun needs the package rerun, which is not installed; install it: " in text
        assert "pip install" in text
    assert f'href="{here}/download/rerun"' not in client.ask(here).text
    assert client.ask(f"{here}/download/rerun", Accept="*/*").headers["content-type"].startswith("text/plain")
