"""Workers build the layouts of a plan as leased jobs of its ledger, and simulate episodes in the built layouts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from coordinator.ledger.reading.audit import ledger_trouble
from coordinator.ledger.reading.reader import open_ledger
from coordinator.ledger.reading.records import read_content_digests
from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from factory.runs.catalog import open_catalog
from factory.scenes.build import package_path
from schemas.dataset.meta import read_dataset_meta
from schemas.plan import Plan
from schemas.protocol.messages import ClaimReply
from schemas.scene import read_scene
from schemas.scene.files import faulty_textures
from schemas.support.child import python_module
from schemas.terms import FailReason
from tests.builders.layout_package import make_layout
from tests.builders.wire_worker import WireWorker, until
from tests.builders.worker import WorkerThread, settings_for
from workers.client.scene_cache import SceneCache

PLAN = Plan.model_validate(
    {
        "name": "two",
        "scenes": [{"name": "office", "layouts": 2, "episodes": 4, "seed": 5, "seen": ["chair"], "held_out": ["rack"]}],
        "splits": {"train_id": 1},
        "tiers": {"near": 1},
        "task": {"success": "centroid"},
        "record": "states",
    }
)
FIRST, SECOND = "office_00005", "office_00006"


def package(layout: str, category: str = "chair") -> bytes:
    """Returns the result of a build: the complete package of a room with one object."""
    return make_layout(layout, category).complete()


class Clock:
    """Clock of a coordinator that a test can set forward."""

    def __init__(self) -> None:
        self.ahead = timedelta()

    def __call__(self) -> datetime:
        return datetime.now(UTC) + self.ahead


@contextmanager
def coordinator(root: Path, clock: Clock | None = None) -> Iterator[Coordinator]:
    catalog = open_catalog(PLAN, root, root.parent / "cache", only=())
    settings = CoordinatorSettings(retry_after_s=0.05, reserve_bytes=0)
    options = CoordinatorOptions(listen=("tcp/127.0.0.1:0",), settings=settings, clock=clock or Clock())
    with Coordinator(root, PLAN, catalog, options) as opened:
        yield opened


def build_claim(worker: WireWorker) -> ClaimReply:
    replies: list[ClaimReply] = []

    def has_build() -> bool:
        replies.append(worker.claim(can_build=True))
        return replies[-1].build is not None

    until(has_build)
    return replies[-1]


def deliver(worker: WireWorker, claim: ClaimReply, data: bytes) -> None:
    assert claim.lease is not None
    assert worker.deliver(claim.lease, data)


def test_episodes_of_a_layout_are_claimed_while_another_one_is_built(tmp_path: Path) -> None:
    data = package(SECOND)  # made before the leases, which end while a slow machine makes it
    with coordinator(tmp_path / "data") as core, WireWorker(core.endpoints, core.run) as worker:
        first, second = build_claim(worker), build_claim(worker)
        assert [(claim.build.layout, claim.build.seed) for claim in (first, second) if claim.build] == [
            (FIRST, 5),
            (SECOND, 6),
        ]
        assert core.progress().jobs["pending"] == core.progress().planned == 4
        deliver(worker, second, data)
        job, lease = worker.job()
        assert (job.scene, job.index) in {(SECOND, 3), (SECOND, 4)}
        assert core.progress().layouts == {"leased": 1, "archived": 1}
        worker.fail(lease, FailReason.RELEASED)


def test_a_worker_that_cannot_build_receives_no_build(tmp_path: Path) -> None:
    with coordinator(tmp_path / "data") as core, WireWorker(core.endpoints, core.run) as worker:
        reply = worker.claim()
        assert (reply.job, reply.build, reply.finished) == (None, None, False)


def test_the_build_of_a_killed_builder_is_leased_again_and_its_late_package_is_ignored(tmp_path: Path) -> None:
    clock = Clock()
    with (
        coordinator(tmp_path / "data", clock) as core,
        WireWorker(core.endpoints, core.run, "killed") as killed,
        WireWorker(core.endpoints, core.run, "other") as other,
    ):
        lost = build_claim(killed)
        build_claim(killed)
        clock.ahead = timedelta(seconds=120)
        again = build_claim(other)
        assert lost.build is not None
        assert lost.lease is not None
        assert again.build == lost.build
        deliver(other, again, package(FIRST))
        other.job()
        assert not killed.deliver(lost.lease, package(FIRST, "plant"))
        assert len(list((tmp_path / "data/scenes").glob("office_00005-*.scene.zip"))) == 1


def test_a_layout_that_cannot_fulfil_the_plan_is_built_again_with_the_next_seed(tmp_path: Path) -> None:
    root = tmp_path / "data"
    with coordinator(root) as core, WireWorker(core.endpoints, core.run) as worker:
        deliver(worker, build_claim(worker), package(FIRST, "plant"))
        failed, again = build_claim(worker), build_claim(worker)
        assert failed.lease is not None
        assert {failed.build.layout, again.build.layout} == {FIRST, SECOND}  # type: ignore[union-attr]
        retried = next(claim for claim in (failed, again) if claim.build is not None and claim.build.layout == FIRST)
        assert retried.build is not None
        assert retried.build.seed == 7
        deliver(worker, retried, package(FIRST))
        # repeats the announcement, because the coordinator ignores it until the transfer of the refused file has ended
        until(lambda: not worker.beat().drop and not worker.spool)
        worker.job()
    assert "no reachable 'chair'" in read_dataset_meta(root).refused_seeds[FIRST][0]
    assert ledger_trouble(f"sqlite:///{root}/ledger.db") == ""


@pytest.mark.parametrize("data", [b"no package", package("office_00007")], ids=["damaged", "of another layout"])
def test_a_file_that_is_not_the_package_of_the_layout_counts_against_the_host(tmp_path: Path, data: bytes) -> None:
    with coordinator(tmp_path / "data") as core, WireWorker(core.endpoints, core.run) as worker:
        deliver(worker, build_claim(worker), data)
        until(lambda: bool(core.progress().hosts))
        assert core.progress().attempts == {"invalid": 1}
        assert not list((tmp_path / "data/scenes").glob("*.zip"))


def test_textures_that_the_coordinator_has_are_not_sent_again(tmp_path: Path) -> None:
    root, shared = tmp_path / "data", make_layout(FIRST).textures.keys() & make_layout(SECOND).textures.keys()
    with coordinator(root) as core, WireWorker(core.endpoints, core.run) as worker:
        first = build_claim(worker)
        assert first.build is not None
        assert first.build.textures == ()
        deliver(worker, first, package(first.build.layout))
        until(lambda: core.progress().layouts.get("archived") == 1)
        second = build_claim(worker)
        assert second.build is not None
        assert set(second.build.textures) == {texture.sha256 for texture in shared}
        deliver(worker, second, make_layout(second.build.layout).complete(second.build.textures))
        until(lambda: core.progress().layouts.get("archived") == 2)
    for layout in (FIRST, SECOND):
        (path,) = (root / "scenes").glob(f"{layout}-*.scene.zip")
        assert path.read_bytes() == make_layout(layout).package
        assert faulty_textures(path) == []
    assert ledger_trouble(f"sqlite:///{root}/ledger.db") == ""
    with coordinator(root) as core:  # a restart keeps layouts and textures
        assert core.progress().layouts == {"archived": 2}
        assert len(list((root / "scenes/textures").iterdir())) == 2


def test_a_layout_sent_without_a_needed_texture_counts_against_the_host(tmp_path: Path) -> None:
    with coordinator(tmp_path / "data") as core, WireWorker(core.endpoints, core.run) as worker:
        claim = build_claim(worker)
        assert claim.build is not None
        layout = make_layout(claim.build.layout)
        deliver(worker, claim, layout.complete({next(iter(layout.textures)).sha256}))
        until(lambda: bool(core.progress().hosts))
        assert core.progress().attempts == {"invalid": 1}
        assert not list((tmp_path / "data/scenes").rglob("*.z*"))
        assert not list((tmp_path / "data/.staging").iterdir())


def test_leftovers_of_an_interrupted_layout_build_are_removed_at_the_next_start(tmp_path: Path) -> None:
    root = tmp_path / "data"
    with coordinator(root) as core, WireWorker(core.endpoints, core.run) as worker:
        build_claim(worker)
    make_layout(FIRST).write(root / "scenes" / "part.scene.zip").unlink()
    make_layout(FIRST).write(root / ".staging" / "layout-x" / "layout.scene.zip")
    assert len(list((root / "scenes/textures").iterdir())) == 2
    with coordinator(root):
        assert not list((root / "scenes/textures").iterdir())
        assert not list((root / ".staging").iterdir())


def test_workers_fetch_a_layout_with_its_textures(tmp_path: Path) -> None:
    with coordinator(tmp_path / "data") as core, WireWorker(core.endpoints, core.run) as worker:
        claim = build_claim(worker)
        assert claim.build is not None
        layout = make_layout(claim.build.layout)
        deliver(worker, claim, layout.complete())
        job, _ = worker.job()
        assert (job.scene_sha256, job.scene_bytes) == (layout.sha256, len(layout.package))
        cache = SceneCache(tmp_path / "cache", 1 << 30)
        path = cache.ensure_scene(job.scene_sha256, job.scene_bytes, worker.fetch_scene, lambda: None)
        assert read_scene(path).info.name == job.scene


def test_a_layout_stored_without_a_commit_is_recorded_at_the_next_start(tmp_path: Path) -> None:
    root = tmp_path / "data"
    with coordinator(root) as core, WireWorker(core.endpoints, core.run) as worker:
        build_claim(worker)
    layout = make_layout(FIRST)
    layout.write(root / "scenes" / f"{FIRST}-{layout.sha256[:16]}.scene.zip")
    with coordinator(root) as core, WireWorker(core.endpoints, core.run) as worker:
        assert core.progress().layouts == {"archived": 1, "pending": 1}
        assert worker.job()[0].scene == FIRST
    assert ledger_trouble(f"sqlite:///{root}/ledger.db") == ""


def test_an_error_of_the_coordinator_itself_is_not_repeated_without_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise KeyError("school")

    monkeypatch.setattr("coordinator.transfer.layouts.expand_layout", fail)
    with coordinator(tmp_path / "data") as core, WireWorker(core.endpoints, core.run) as worker:
        claim = build_claim(worker)
        assert claim.build is not None
        data = make_layout(claim.build.layout).complete()

        def is_stopped() -> bool:
            deliver(worker, claim, data)
            try:
                core.is_finished()
            except RuntimeError as error:
                return "pull_failed 5 times by the same error: KeyError: 'school'" in str(error)
            return False

        until(is_stopped)
    assert ledger_trouble(f"sqlite:///{tmp_path}/data/ledger.db") == ""


_DIES_ONCE = """
import os, pathlib, signal, sys
died = pathlib.Path(sys.argv[1])
if not died.exists():
    os.write(1, b'{"kind": "ready"}\\n')
    sys.stdin.readline()
    died.touch()
    os.kill(os.getpid(), signal.SIGKILL)
from factory.runs.build_process import main
sys.exit(main())
"""


def content_digests(folder: Path, *build_command: str) -> list[str]:
    """Runs a plan with one worker and returns the digests of its episodes."""
    with coordinator(folder / "data") as core:
        settings = settings_for(core.endpoints[0], folder, command=(), build_command=build_command)
        with WorkerThread(settings) as worker:
            assert worker.join() == 0
        assert core.is_finished()
        assert core.progress().jobs["archived"] == PLAN.episodes
    with open_ledger(f"sqlite:///{folder}/data/ledger.db") as connection:
        return read_content_digests(connection)


@pytest.mark.slow
def test_a_killed_builder_does_not_change_the_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MINIVLA_CACHE", str(tmp_path))
    (tmp_path / "scenes").mkdir()
    for layout, seed, category in ((FIRST, 5, "plant"), (FIRST, 7, "chair"), (SECOND, 6, "chair")):
        make_layout(layout, category).write(package_path("office", seed, tmp_path / "scenes", called=layout))
    whole = content_digests(tmp_path / "whole", *python_module("factory.runs.build_process"))
    killed = content_digests(tmp_path / "killed", sys.executable, "-c", _DIES_ONCE, str(tmp_path / "died"))
    assert (tmp_path / "died").exists()
    assert killed == whole
