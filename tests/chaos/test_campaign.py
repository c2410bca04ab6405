"""A short chaos campaign with fake simulations, which tests the protocol; `make chaos` runs the long one."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from schemas.plan import Budget
from schemas.terms import Recording
from tests.chaos.cluster import ChaosCluster, fake_commands
from tests.chaos.peers import Peers
from tests.chaos.round import FaultLoad, reference_digest, run_round
from tests.chaos.verdict import digest_of, gather_problems, violations_of

EPISODES = 10
FAULTS = 16


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ChaosCluster]:
    """Dataset digest of a run with one worker and no faults, and the cluster of that run after its end."""
    root = tmp_path_factory.mktemp("reference")
    with ChaosCluster(root, fake_commands(EPISODES, 0.0), 1) as cluster:
        deadline = time.monotonic() + 240
        while len(cluster.archived()) < EPISODES:
            assert time.monotonic() < deadline, cluster.log.read_text()[-4000:]
            time.sleep(0.05)
        cluster.end()
    assert cluster.violations == []
    return digest_of(cluster), cluster


@pytest.mark.slow
@pytest.mark.parametrize("record", Recording)
def test_dataset_of_a_run_with_faults_equals_that_of_an_undisturbed_run(record, reference, tmp_path):
    undisturbed = (
        reference[0]
        if record is Recording.FRAMES
        else reference_digest(fake_commands(EPISODES, 0.0, record=record), tmp_path / "reference")
    )
    # a killed process imports for seconds when it starts again; most faults in this time would have no effect
    load = FaultLoad(workers=2, faults=FAULTS, pause_s=(0.3, 1.5))
    tally = run_round(fake_commands(EPISODES, 3.0, record=record), tmp_path / "faults", load, 7, undisturbed)
    assert tally.violations == []
    assert tally.faults.total() >= FAULTS // 2
    assert tally.outcomes["success"] == tally.episodes == EPISODES


@pytest.mark.slow
def test_kills_while_packing_neither_lose_nor_duplicate_episodes(tmp_path):
    commands = fake_commands(24, 1.5, checkpoint_s=0.3, record=Recording.STATES)
    at_once = fake_commands(24, 0.0, record=Recording.STATES)  # the content does not depend on the duration
    undisturbed = reference_digest(at_once, tmp_path / "reference")
    load = FaultLoad(workers=2, faults=FAULTS, pause_s=(0.02, 0.2))
    tally = run_round(commands, tmp_path / "faults", load, 3, undisturbed)
    assert tally.violations == []
    assert tally.outcomes["success"] == tally.episodes == 24
    assert tally.faults.total() > 0


@pytest.mark.slow
def test_a_hostile_peer_and_a_faulty_host_neither_change_nor_lose_episodes(tmp_path):
    crashes = Budget().crashes  # the default of a plan
    reference = reference_digest(fake_commands(EPISODES, 0.0, crashes=crashes), tmp_path / "reference")
    load = FaultLoad(workers=2, faults=0, peers=Peers(pause_s=(0.02, 0.1), damages=(1.0,)))
    tally = run_round(fake_commands(EPISODES, 1.0, crashes=crashes), tmp_path / "faults", load, 1, reference)
    assert tally.violations == []
    assert tally.outcomes["success"] == tally.episodes == EPISODES
    assert tally.faults.total() >= FAULTS
    assert tally.outcomes["invalid"] + tally.outcomes["crash"] > 0


@pytest.mark.slow
def test_workers_switch_gateways_after_a_kill_and_the_gathered_dataset_has_the_reference_digest(reference, tmp_path):
    with ChaosCluster(tmp_path, fake_commands(EPISODES, 3.0, gateways=2), 2) as cluster:
        deadline = time.monotonic() + 240
        is_killed = False
        while len(cluster.archived()) < EPISODES:
            assert time.monotonic() < deadline, cluster.log.read_text()[-4000:]
            done = len(cluster.archived())
            if not is_killed and done >= 2:  # the gateway stays down until half of the episodes are archived
                is_killed = cluster.kill_gateway(0, float("inf")) is not None
            cluster.tend(at_once=is_killed and done > EPISODES // 2)
            time.sleep(0.05)
        assert is_killed
        cluster.end()
        assert cluster.violations == []
        assert cluster.query("select count(*) from keepers where gateway = 'gw1'") > [(0,)]  # gw1 was not killed
        assert list(gather_problems(cluster)) == []
        assert list(violations_of(cluster)) == []
        assert digest_of(cluster) == reference[0]


def test_the_verdict_detects_torn_missing_surplus_and_stale_data(reference):
    cluster = reference[1]
    assert list(violations_of(cluster)) == []
    first: Path = cluster.out / "episodes" / "ep_000001.zip"
    whole = first.read_bytes()
    try:
        first.write_bytes(whole[:-1] + b"x")
        assert "episode 1 is torn" in list(violations_of(cluster))
        first.unlink()
        assert any(text.startswith("files") for text in violations_of(cluster))
        first.write_bytes(whole)
        stray = first.with_name("ep_000099.zip")
        stray.write_bytes(whole)
        assert any("quarantine episodes/ep_000099.zip" in text for text in violations_of(cluster))
        stray.unlink()
        part = cluster.out / ".staging" / "x.part"
        part.touch()
        assert "part files are left" in list(violations_of(cluster))
        part.unlink()
    finally:
        first.write_bytes(whole)
