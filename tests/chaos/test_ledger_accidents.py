"""Damages the ledger of a small run once with each kind of damage; `make ledger-accidents` damages it fifty times."""

from __future__ import annotations

import pytest

from tests.chaos.accidents import ACCIDENTS
from tests.chaos.cluster import fake_commands
from tests.chaos.ledger_accidents import run_accidents
from tests.chaos.round import reference_digest

EPISODES = 8


@pytest.mark.slow
def test_no_episode_is_simulated_twice_after_damage_to_the_ledger(tmp_path):
    commands = fake_commands(EPISODES, 0.5, checkpoint_s=1.0)
    reference = reference_digest(commands, tmp_path / "reference")
    tally = run_accidents(commands, tmp_path / "run", list(ACCIDENTS), 3, reference)
    assert tally.violations == []
    assert tally.faults.total() == len(ACCIDENTS)
    assert tally.episodes == EPISODES
