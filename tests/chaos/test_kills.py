"""Sends signals to single processes of a small cluster and checks how the cluster reacts."""

from __future__ import annotations

import signal
import time

from tests.chaos.cluster import ChaosCluster, fake_commands
from workers.client.supervisor import STOPPED


def test_worker_obeys_sigterm_within_five_seconds_while_the_coordinator_is_frozen(tmp_path):
    with ChaosCluster(tmp_path, fake_commands(30, 600.0), 1) as cluster:
        deadline = time.monotonic() + 60
        while cluster.leased() < 2:
            assert time.monotonic() < deadline, cluster.log.read_text()[-4000:]
            cluster.tend()
            time.sleep(0.1)
        cluster.coordinator.send_signal(signal.SIGSTOP)
        cluster.workers[0].send_signal(signal.SIGTERM)
        assert cluster.workers[0].wait(5) == STOPPED
