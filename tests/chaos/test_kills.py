"""Signals to single processes of a small party, each with the one thing that has to happen."""

from __future__ import annotations

import signal
import time

from tests.chaos.cluster import ChaosCluster, fake_commands


def test_worker_obeys_sigterm_within_five_seconds_while_the_coordinator_is_frozen(tmp_path):
    with ChaosCluster(tmp_path, fake_commands(30, 600.0), 1) as party:
        deadline = time.monotonic() + 60
        while party.leased() < 2:
            assert time.monotonic() < deadline, party.log.read_text()[-4000:]
            party.tend()
            time.sleep(0.1)
        party.coordinator.send_signal(signal.SIGSTOP)
        party.workers[0].send_signal(signal.SIGTERM)
        assert party.workers[0].wait(5) == 0
