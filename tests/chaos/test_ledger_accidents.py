"""One accident of each kind to the ledger of a small run; fifty of them are `make ledger-accidents`."""

from __future__ import annotations

import pytest

from tests.chaos.accidents import ACCIDENTS
from tests.chaos.cluster import fake_commands
from tests.chaos.ledger_accidents import play_accidents
from tests.chaos.round import calm_digest

EPISODES = 8


@pytest.mark.slow
def test_no_episode_is_simulated_twice_after_damage_to_the_ledger(tmp_path):
    cast = fake_commands(EPISODES, 0.5, checkpoint_s=1.0)
    calm = calm_digest(cast, tmp_path / "calm")
    tally = play_accidents(cast, tmp_path / "run", list(ACCIDENTS), 3, calm)
    assert tally.violations == []
    assert tally.faults.total() == len(ACCIDENTS)
    assert tally.episodes == EPISODES
