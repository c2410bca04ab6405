"""Hostile clients of the web page of a run: floods, slow clients, forged forms and malformed input change nothing."""

from __future__ import annotations

import http.client
import os
import ssl
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import pytest

from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.dataset.reader import Dataset
from factory.dataset.site import site_of
from factory.web.start import serve
from schemas.errors import UsageError
from schemas.protocol.keys import Verb
from schemas.protocol.messages import Beat, BeatReply, HelloReply, HostMemory
from schemas.support.product import product_version
from schemas.terms import Recording
from tests.benchmarks.attack import flood, slow_clients
from tests.builders.archived import ArchivedRun
from tests.builders.dataset import make_dataset
from tests.builders.keys import files_of, make_authority
from tests.builders.ledger import room_catalog, room_plan
from tests.builders.web import WebClient, web_page
from tests.builders.wire_worker import WireWorker, bundle_for, until

FLOOD = 10_000
TEXTS = (
    "\x00",
    "\u202e\u0000x",
    "🤖" * 300,
    "%",
    "%ff",
    "'; DROP TABLE jobs; --",
    "<script>",
    "../" * 40,
    "\ud7ff\uffff",
)


@pytest.fixture
def run(tmp_path: Path) -> Iterator[tuple[Coordinator, WebClient]]:
    settings = CoordinatorSettings(reserve_bytes=0, retry_after_s=0.1, pullers=1, pull_timeout_s=5.0)
    options = CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings)
    with (
        Coordinator(tmp_path / "out", room_plan(3), room_catalog(tmp_path), options) as coordinator,
        web_page(tmp_path / "out", administer=coordinator.administer) as client,
    ):
        yield coordinator, client


@pytest.mark.slow
def test_ten_thousand_hostile_requests_change_nothing_and_the_run_ends(run):
    coordinator, client = run
    attack = threading.Thread(target=flood, args=(client.host, FLOOD))
    attack.start()
    with WireWorker(coordinator.endpoints, coordinator.run) as worker:
        for _ in range(3):
            job, lease = worker.job()
            assert worker.deliver(lease, bundle_for(job))
        until(lambda: coordinator.progress().finished)
    attack.join()
    assert coordinator.progress().jobs["archived"] == 3
    page = client.ask("/").text
    assert "3 of 3 episodes archived" in page
    assert "<h2>Operations</h2>" not in page  # the list of executed requests is empty


def test_a_server_with_many_slow_clients_answers_other_clients_and_the_run_continues(run):
    coordinator, client = run
    with slow_clients(client.host, 120), WireWorker(coordinator.endpoints, coordinator.run) as worker:
        assert client.ask("/").status == 200
        job, lease = worker.job()
        assert worker.deliver(lease, bundle_for(job))
        until(lambda: coordinator.progress().jobs["archived"] == 1)


def test_the_farm_page_shows_the_memory_that_a_heartbeat_reports(run):
    coordinator, client = run
    with WireWorker(coordinator.endpoints, coordinator.run) as worker:
        assert isinstance(worker.hello(product_version()), HelloReply)
        memory = HostMemory(used_bytes=3 * 10**9, total_bytes=8 * 10**9)
        assert isinstance(worker.ask(Verb.BEAT, Beat(sid=worker.sid, memory=memory), BeatReply), BeatReply)
        until(lambda: "3.0 GB of 8.0 GB" in client.ask("/").text)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("odd") / "data"
    make_dataset(root, 2)
    return root


def test_malformed_text_in_paths_and_queries_is_refused_or_not_found(data):
    with web_page(data) as client:
        for text in TEXTS:
            odd = quote(text, errors="surrogatepass", safe="")
            for path in (f"/episodes/{odd}", f"/scenes/{odd}", f"/evaluations/{odd}", f"/operations/{odd}", f"/{odd}"):
                assert client.ask(path).status in (404, 414), (text, path)
            for query in (f"q={odd}", f"split={odd}", f"target={odd}"):
                reply = client.ask(f"/episodes?{query}")
                assert reply.status == 400 or "0 of 2 episodes" in reply.text, (text, query)
                assert "<script>" not in reply.text.replace('<script src="/static/', "")
            assert client.ask(f"/episodes?sort={odd}").status == 400
            assert client.ask(f"/episodes?page={odd}").status == 400
        assert client.ask("/episodes?page=999999999").status == 200
        assert client.ask(f"/episodes?q={'a' * 201}").status == 400
        assert client.ask("/" + "a" * 20_000).status in (400, 404, 431)


def test_a_dataset_that_grows_is_shown_as_it_is_written(tmp_path):
    run = ArchivedRun(tmp_path / "run", planned=4, done=2)
    with web_page(run.root) as client:
        assert "2 of 2 episodes" in client.ask("/episodes").text
        (run.root / "episodes" / "ep_000003.zip.part").write_bytes(b"half")
        os.utime(run.root / "metadata.parquet")
        assert "2 of 2 episodes" in client.ask("/episodes").text
        (run.root / "metadata.parquet").write_bytes((run.root / "metadata.parquet").read_bytes()[:200])
        until(lambda: client.ask("/episodes").status == 503)
        assert "metadata.parquet" in client.ask("/episodes").text
        scenes = client.ask("/scenes").text
        assert "The episodes cannot be counted: " in scenes
        assert "metadata.parquet" in scenes
        assert "0 episodes" not in scenes
        assert "2 of 4 episodes archived" in client.ask("/").text


def test_a_half_packed_dataset_shows_packed_and_single_episodes(tmp_path):
    run = ArchivedRun(tmp_path / "run", planned=6, done=5, record=Recording.STATES)
    assert run.pack(2, is_over=False) == 4
    with web_page(run.root) as client:
        for index in range(1, 6):
            assert client.ask(f"/episodes/ep_{index:06d}").status == 200
            assert (
                client.ask(f"/episodes/ep_{index:06d}/download/zip").body
                == Dataset(run.root)[index - 1].path.read_bytes()
            )


def answer(client: http.client.HTTPSConnection, host: str) -> int:
    client.request("GET", "/", headers={"Host": host})
    return client.getresponse().status


def test_with_tls_reading_requires_a_client_certificate_and_changes_also_require_the_token(data, tmp_path):
    pki = make_authority(tmp_path / "pki", ("node",), ("boss",))
    files = files_of(pki, "boss")
    with serve(site_of(str(data)), "127.0.0.1:0", None, pki / "hub") as url:
        assert url.startswith("https://")
        host, _, token = url.removeprefix("https://").partition("/?token=")
        name, _, port = host.rpartition(":")
        known = ssl.create_default_context(cafile=str(files.ca))
        known.check_hostname = False
        unknown = ssl.create_default_context(cafile=str(files.ca))
        unknown.check_hostname = False
        known.load_cert_chain(files.certificate, files.key)
        connection = http.client.HTTPSConnection(name, int(port), timeout=60, context=known)
        connection.request("GET", "/episodes", headers={"Host": host})
        reply = connection.getresponse()
        assert (reply.status, b"2 of 2 episodes" in reply.read()) == (200, True)
        connection.request("POST", "/operations/pause", "confirm=1", {"Host": host})
        assert connection.getresponse().status == 401
        connection.close()
        connection.request("GET", f"/?token={token}", headers={"Host": host})
        assert "; secure" in connection.getresponse().headers["set-cookie"].lower()
        connection.close()
        stranger = http.client.HTTPSConnection(name, int(port), timeout=60, context=unknown)
        with pytest.raises((ssl.SSLError, ConnectionError)):
            answer(stranger, host)
        with pytest.raises((http.client.BadStatusLine, ConnectionError)):
            WebClient(host, token).ask("/")


def test_the_page_of_a_dataset_is_not_served_to_other_machines_without_protection(data):
    with pytest.raises(UsageError, match="reachable from other machines"), serve(site_of(str(data)), "[::]:0", None):
        pass
