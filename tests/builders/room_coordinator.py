"""Runs the coordinator of a minimal run as a process, for kill tests.

Arguments: `ROOT EPISODES ENDPOINT LEASE_S [CHECKPOINT_S [CRASHES [RECORD [STORE]]]]`. If RECORD is `states`, each
range of `SHARD_EPISODES` episodes is packed.
"""

from __future__ import annotations

import sys
from pathlib import Path

from coordinator.options import CoordinatorOptions
from coordinator.service import Coordinator
from coordinator.settings import CoordinatorSettings
from schemas.storage.object_path import ObjectPath
from schemas.terms import Recording
from tests.builders.ledger import room_catalog, room_plan
from workers.client.stopping import stop_on_signals

SHARD_EPISODES = 4


def main() -> None:
    root, episodes, endpoint, lease_s = Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3], float(sys.argv[4])
    checkpoint_s = float(sys.argv[5]) if len(sys.argv) > 5 else 30.0
    crashes = int(sys.argv[6]) if len(sys.argv) > 6 else 20
    record = Recording(sys.argv[7]) if len(sys.argv) > 7 else Recording.FRAMES
    store = ObjectPath.at(sys.argv[8]) if len(sys.argv) > 8 else None
    root.mkdir(parents=True, exist_ok=True)
    settings = CoordinatorSettings(
        lease_ttl_s=lease_s,
        retry_after_s=0.2,
        pull_timeout_s=1.0,
        reserve_bytes=0,
        transport_lease_s=2.0,
        checkpoint_s=checkpoint_s,
        shard_episodes=SHARD_EPISODES,
    )
    plan = room_plan(episodes, record, crashes=crashes)
    with (
        stop_on_signals() as (stop, _),
        Coordinator(
            root / "out",
            plan,
            room_catalog(root),
            CoordinatorOptions(listen=(endpoint,), settings=settings, store=store),
        ),
    ):
        while not stop.wait(0.2):
            pass


if __name__ == "__main__":
    main()
