"""A short campaign in every test run; the long one is `make chaos`. Simulations are fake: the protocol is on trial."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from schemas.plan import Budget
from tests.chaos.cluster import ChaosCluster, fake_commands
from tests.chaos.peers import Peers
from tests.chaos.round import Storm, calm_digest, play_round
from tests.chaos.verdict import digest_of, gathering_of, violations_of

EPISODES = 10
FAULTS = 16


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ChaosCluster]:
    """The digest one undisturbed worker makes, and the party when everybody has left."""
    root = tmp_path_factory.mktemp("calm")
    with ChaosCluster(root, fake_commands(EPISODES, 0.0), 1) as party:
        deadline = time.monotonic() + 240
        while len(party.archived()) < EPISODES:
            assert time.monotonic() < deadline, party.log.read_text()[-4000:]
            time.sleep(0.05)
        party.end()
    assert party.violations == []
    return digest_of(party), party


@pytest.mark.slow
def test_dataset_of_a_run_with_faults_equals_that_of_an_undisturbed_run(calm, tmp_path):
    storm = Storm(workers=2, faults=FAULTS, pause_s=(0.05, 0.3))
    tally = play_round(fake_commands(EPISODES, 3.0), tmp_path / "wild", storm, 7, calm[0])
    assert tally.violations == []
    assert tally.faults.total() >= FAULTS // 2
    assert tally.outcomes["success"] == tally.episodes == EPISODES


@pytest.mark.slow
def test_a_hostile_peer_and_a_faulty_host_neither_change_nor_lose_episodes(tmp_path):
    cast = fake_commands(EPISODES, 1.0, crashes=Budget().crashes)  # of a default plan
    calm = calm_digest(cast, tmp_path / "calm")
    storm = Storm(workers=2, faults=0, peers=Peers(pause_s=(0.02, 0.1), damages=(1.0,)))
    tally = play_round(cast, tmp_path / "wild", storm, 1, calm)
    assert tally.violations == []
    assert tally.outcomes["success"] == tally.episodes == EPISODES
    assert tally.faults.total() >= FAULTS
    assert tally.outcomes["invalid"] + tally.outcomes["crash"] > 0


def test_workers_switch_gateways_after_a_kill_and_the_gathered_dataset_is_equal(calm, tmp_path):
    with ChaosCluster(tmp_path, fake_commands(EPISODES, 3.0, gateways=2), 2) as party:
        deadline = time.monotonic() + 240
        is_killed = False
        while len(party.archived()) < EPISODES:
            assert time.monotonic() < deadline, party.log.read_text()[-4000:]
            done = len(party.archived())
            if not is_killed and done >= 2:  # it stays away until the other has taken over
                is_killed = party.kill_gateway(0, float("inf")) is not None
            party.tend(everybody=is_killed and done > EPISODES // 2)
            time.sleep(0.05)
        assert is_killed
        party.end()
        assert party.violations == []
        assert party.query("select count(*) from keepers where gateway = 'gw1'") > [(0,)]  # the one that was left
        assert list(gathering_of(party)) == []
        assert list(violations_of(party)) == []
        assert digest_of(party) == calm[0]


def test_the_verdict_detects_torn_missing_surplus_and_stale_data(calm):
    party = calm[1]
    assert list(violations_of(party)) == []
    first: Path = party.out / "episodes" / "ep_000001.zip"
    whole = first.read_bytes()
    try:
        first.write_bytes(whole[:-1] + b"x")
        assert "episode 1 is torn" in list(violations_of(party))
        first.unlink()
        assert any(text.startswith("files") for text in violations_of(party))
        first.write_bytes(whole)
        stray = first.with_name("ep_000099.zip")
        stray.write_bytes(whole)
        assert any("quarantine episodes/ep_000099.zip" in text for text in violations_of(party))
        stray.unlink()
        part = party.out / ".staging" / "x.part"
        part.touch()
        assert "part files are left" in list(violations_of(party))
        part.unlink()
    finally:
        first.write_bytes(whole)
