"""Content of the web page besides tables: evaluations, maps of failures, sub-instructions, downloads, the 3D view."""

from __future__ import annotations

import io
import json
import re
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlencode

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sqlalchemy import update

from coordinator.ledger import hosts
from coordinator.ledger.hosts import write_memory
from coordinator.ledger.opening import ledger_url_of
from coordinator.ledger.tables import LEDGER_FORMAT, jobs
from factory.dataset.reader import Dataset
from factory.dataset.rendering import shared_renderer
from factory.eval.models.result import Variant
from factory.eval.results.compare import compare
from factory.eval.results.publish import pair_folder
from factory.relabel.part import STEPS_SCHEMA
from factory.web.pages.episodes import prepare_scenes
from schemas.language.route.meaning import RouteStep
from schemas.plan import Plan
from schemas.protocol.messages import Hello, HostMemory
from schemas.storage.dataset_files import STEPS_FILE
from schemas.terms import FailReason, Recording
from tests.builders.bundle import GOAL_M
from tests.builders.catalog import make_catalog
from tests.builders.dataset import make_dataset
from tests.builders.eval_results import result_of, write_evaluation
from tests.builders.ledger import TimedLedger, room_plan
from tests.builders.web import WebClient, web_page
from tests.builders.wire_worker import until

POLICIES = ("stop", "my policy <b>")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("content") / "data"
    make_dataset(root, 2)
    meaning = (RouteStep(kind="forward", metres=2), RouteStep(kind="forward", metres=3))
    spans = ((0, 5), (5, len(Dataset(root)["ep_000001"])))
    rows = [
        {"episode_id": "ep_000001", "index": 1, "number": 1, "step": number, "start": start, "end": end}
        | {"kind": "forward", "instruction": f"Drive <{number}> on.", "language": "en", "register": "plain"}
        | {"template_id": "t", "meaning": step.model_dump_json(), "held_out": False}
        for number, (step, (start, end)) in enumerate(zip(meaning, spans, strict=True), 1)
    ]
    pq.write_table(pa.Table.from_pylist(rows, STEPS_SCHEMA), root / STEPS_FILE)
    return root


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An evaluation of two policies; one failure of the first policy has a film."""
    return write_evaluation(tmp_path_factory.mktemp("evaluation") / "results", POLICIES)


@pytest.fixture(scope="module")
def client(data: Path, evaluation: Path) -> Iterator[WebClient]:
    with web_page(data, evaluations=(evaluation,)) as found:
        yield found


def test_the_page_of_an_evaluation_lists_failures_and_links_to_their_episodes_and_films(client):
    assert '<a href="/evaluations/results">' in client.ask("/evaluations").text
    page = client.ask("/evaluations/results").text
    assert "my policy &lt;b&gt;" in page
    assert '<a href="/episodes/ep_000001">ep_000001</a>' in page
    assert '<a href="/episodes/ep_000005">' not in page  # the dataset has two episodes
    films = re.findall(r'src="([^"]+\.mp4)"', page)
    assert [client.ask(film).body for film in films] == [b"film of ep_000001"]
    assert client.ask(films[0].replace("mp4", "jpg")).headers["content-type"] == "image/jpeg"


@pytest.mark.parametrize(
    "name",
    ["1/ep_000002.mp4", "1/..%2f..%2f..%2fresults.json", "1/ep_000001.json", "7/ep_000001.mp4", "0/ep_000001.mp4"],
)
def test_only_films_of_failures_are_served(client, name):
    assert client.ask(f"/evaluations/results/films/{name}").status == 404


def test_a_page_compares_two_policies_with_the_numbers_of_the_command(client):
    rows = [
        [result_of(n, success=n % wins == 0, policy=name) for n in range(1, 7)]
        for name, wins in zip(POLICIES, (2, 3), strict=True)
    ]
    wanted = compare(*rows, Variant.ORIGINAL)
    page = client.ask("/evaluations/results?first=stop&second=my+policy+%3Cb%3E").text
    assert f"both {wanted.both}, only stop {wanted.only_first}, " in page
    assert f"McNemar p = {wanted.p:.3g}" in page
    assert f"{100 * wanted.success_difference.mean:+.1f}" in page
    assert "no policy &#39;other&#39;" in client.ask("/evaluations/results?first=other&second=stop").text
    assert client.ask("/evaluations/results?first=stop&second=stop&variant=odd").status == 400
    assert "no evaluation is named &#39;result&#39;; did you mean" in client.ask("/evaluations/result").text


def test_a_comparison_shows_the_films_of_episodes_that_one_policy_completed(data, evaluation):
    first, second = POLICIES
    folder = pair_folder(evaluation, first, second)
    folder.mkdir(parents=True)
    for number in (1, 2):
        (folder / f"ep_{number:06d}.mp4").write_bytes(b"film of a pair")
        (folder / f"ep_{number:06d}.jpg").write_bytes(b"picture")
    with web_page(data, evaluations=(evaluation,)) as client:
        for order in (POLICIES, POLICIES[::-1]):
            page = client.ask("/evaluations/results?" + urlencode({"first": order[0], "second": order[1]})).text
            films = re.findall(r'src="([^"]+/pairs/[^"]+\.mp4)"', page)
            assert [film.rpartition("/")[2] for film in films] == ["ep_000002.mp4"]  # in episode 1, both failed
            assert client.ask(films[0]).body == b"film of a pair"
            assert "No difference between" in page
        for name in ("0/1/..%2f..%2fresults.json", "0/7/ep_000002.mp4", "0/0/ep_000002.mp4", "0/1/ep_000001.json"):
            assert client.ask(f"/evaluations/results/pairs/{name}").status == 404


def test_a_damaged_evaluation_is_named_and_the_other_one_is_shown(data, evaluation, tmp_path):
    (tmp_path / "evaluation.json").write_text("{}")
    with web_page(data, evaluations=(tmp_path, evaluation)) as client:
        page = client.ask("/evaluations")
        assert page.status == 200
        assert "evaluation.json is damaged" in page.text
        assert "Main metrics" in page.text
        assert client.ask(f"/evaluations/{tmp_path.name}").status == 503


def test_sub_instructions_are_on_the_timeline_with_their_steps(client, data):
    page = client.ask("/episodes/ep_000001?t=6").text
    steps = re.findall(r'<li value="(\d)" data-first="(\d+)" data-last="(\d+)"( aria-current=step)?>', page)
    assert steps == [("1", "0", "4", ""), ("2", "5", str(len(Dataset(data)["ep_000001"]) - 1), " aria-current=step")]
    assert "Drive &lt;1&gt; on." in page
    assert "Sub-instructions" not in client.ask("/episodes/ep_000002").text


def test_a_download_for_lerobot_is_a_dataset_of_the_episode(client, data):
    reply = client.ask("/episodes/ep_000002/download/lerobot")
    assert reply.status == 200
    with zipfile.ZipFile(io.BytesIO(reply.body)) as archive:
        info = json.loads(archive.read("ep_000002_lerobot/meta/info.json"))
    assert (info["total_episodes"], info["total_frames"]) == (1, len(Dataset(data)["ep_000002"]))


def test_the_3d_view_has_the_mesh_of_the_scene_and_the_trajectory(client, data):
    page = client.ask("/scenes/office/3d?episode=ep_000001").text
    poses = re.search(r'data-poses="([^"]*)"', page)
    assert poses is not None
    found = np.array([[float(number) for number in row.split(",")[:2]] for row in poses[1].split()])
    assert np.allclose(found, Dataset(data)["ep_000001"].poses[:, :2], atol=0.001)
    mesh = client.ask(re.search(r'data-scene="([^"]*)"', page)[1]).body
    assert struct.unpack_from("<4sII", mesh) == (b"glTF", 2, len(mesh))
    assert "three.module" not in client.ask("/episodes/ep_000001").text  # no other page loads this script
    assert client.ask("/scenes/office/3d").status == 200
    assert client.ask("/scenes/office/3d?episode=ep_000009").status == 404
    assert client.ask("/scenes/offic/scene.glb").status == 404


def test_failures_are_drawn_at_the_robot_or_at_their_target(tmp_path):
    make_dataset(tmp_path / "data", 1)
    timed_ledger = TimedLedger(room_plan(2), ledger_url_of(tmp_path / "data"))
    details = ("collision after 7 steps at (1.25, -0.75) m, 3.00 m from chair_001", "timeout <after> 9 steps")
    for reason, detail in zip((FailReason.COLLISION, FailReason.TIMEOUT), details, strict=True):
        assert timed_ledger.fail(timed_ledger.lease(), reason, detail=detail)
    with timed_ledger.open() as connection:
        connection.execute(update(jobs).values(scene="office", target_id="chair_001"))
        write_memory(connection, {"host": HostMemory(used_bytes=3 * 10**9, total_bytes=8 * 10**9)})
        hosts.register(connection, Hello(sid="host.1", host="host", slots=2, version="1.2"), timed_ledger.now)
    timed_ledger.engine.dispose()
    with web_page(tmp_path / "data") as client:
        farm = client.ask("/").text
        assert '<a href="/scenes/office#map">office</a> 2' in farm
        assert "3.0 GB of 8.0 GB" in farm
        assert f"Ledger: format {LEDGER_FORMAT}" in farm
        page = client.ask("/scenes/office").text
        marks = re.findall(r'<circle class="failure ([a-z ]+)" cx="([^"]+)" cy="([^"]+)"', page)
        assert marks == [("timeout ring", f"{GOAL_M[0]:.2f}", f"{-GOAL_M[1]:.2f}"), ("collision", "1.25", "0.75")]
        assert "timeout &lt;after&gt; 9 steps" in page
        drawn = client.ask("/scenes/office/failures.svg")
        assert drawn.text.count("<circle") == 2
        assert "script-src" not in drawn.headers["content-security-policy"]


def test_a_run_before_its_first_tables_is_not_reported_as_a_missing_dataset(tmp_path):
    (tmp_path / "data").mkdir()
    timed_ledger = TimedLedger(room_plan(2), ledger_url_of(tmp_path / "data"))
    timed_ledger.engine.dispose()
    with web_page(tmp_path / "data") as client:
        reply = client.ask("/episodes")
        assert reply.status == 503
        assert f"run {timed_ledger.plan.run} has no tables of episodes yet" in reply.text
        assert "soon after the first archived episode" in reply.text
        make_dataset(tmp_path / "data", 1)
        until(lambda: client.ask("/episodes").status == 200)


def test_layouts_that_are_not_built_are_named_and_their_builds_do_not_count_as_episodes(tmp_path):
    make_dataset(tmp_path / "data", 1)
    home = {"name": "home", "layouts": 3, "episodes": 3, "seed": 10}
    shares = {"tiers": {"near": 1}, "splits": {"train_id": 1}}
    plan = Plan.model_validate({"name": "x", "scenes": [home], **shares})
    first = {"home_00010": make_catalog(plan)["home_00010"]}
    ledger = TimedLedger(plan, ledger_url_of(tmp_path / "data"), first)
    assert [ledger.claim().scene for _ in range(2)] == ["home_00010", "home_00011"]
    with ledger.open() as connection:
        hosts.register(connection, Hello(sid="host-1", host="host", slots=2, version="1.2"), ledger.now)
    ledger.engine.dispose()
    with web_page(tmp_path / "data") as client:
        farm = client.ask("/").text
        assert "2 episodes are in layouts that are not built yet" in farm
        assert "builds home_00011" in farm
        assert re.findall(r"<td>(ep_\w+|home_\w+)</td>", farm) == ["home_00011", "ep_000001"]
        assert "home_00011, home_00012" in client.ask("/scenes?family=home").text
        reply = client.ask("/scenes/home_00012")
        assert (reply.status, "home_00012 is not built yet" in reply.text) == (404, True)


def test_the_table_of_states_episodes_prepares_the_renderer_before_an_episode_is_opened(recordings, monkeypatch):
    monkeypatch.setenv("MINIVLA_RENDERER", "auto")  # other tests do not use the rendering processes of this renderer
    scene = Dataset(recordings[Recording.STATES])[0].package.sha256
    with web_page(recordings[Recording.STATES]) as client:
        client.ask("/")
        assert shared_renderer().prepared_scenes == []
        client.ask("/episodes")
        until(lambda: any(scene in prepared for prepared in shared_renderer().prepared_scenes))


def test_a_server_that_renders_ahead_prepares_the_renderer_before_any_page_is_opened(recordings, monkeypatch):
    monkeypatch.setenv("MINIVLA_RENDERER", "auto")
    scene = Dataset(recordings[Recording.STATES])[0].package.sha256
    with web_page(recordings[Recording.STATES], renders_ahead=True):
        until(lambda: any(scene in prepared for prepared in shared_renderer().prepared_scenes))


@pytest.mark.parametrize(("is_written", "prepared"), [(False, [4, 4]), (True, [1])])
def test_during_a_run_only_the_first_table_prepares_a_scene(monkeypatch, is_written: bool, prepared: list[int]):
    calls: list[int] = []
    frames = SimpleNamespace(prepare=lambda keys: calls.append(len(keys)))
    context = SimpleNamespace(frames=frames, workspace=SimpleNamespace(is_written=lambda: is_written))
    rows = [{"scene": f"home_{number:05}", "episode_id": f"ep_{number:06}"} for number in range(6)]
    for _ in range(2):
        frames.has_prepared = bool(calls)
        prepare_scenes(context, rows)  # type: ignore[arg-type]
    assert calls == prepared
