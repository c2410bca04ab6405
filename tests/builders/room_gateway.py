"""Runs a gateway of a minimal run as a process, for kill tests. Arguments: `ROOT NAME CORE_ENDPOINT ENDPOINT`."""

from __future__ import annotations

import sys
from pathlib import Path

from coordinator.gateway.service import Gateway
from coordinator.settings import CoordinatorSettings
from schemas.errors import TransientError
from workers.client.stopping import stop_on_signals


def main() -> None:
    root, name, core, endpoint = Path(sys.argv[1]), *sys.argv[2:5]
    settings = CoordinatorSettings(pull_timeout_s=1.0, reserve_bytes=0, transport_lease_s=2.0)
    with stop_on_signals() as (stop, _):
        try:
            with Gateway(root, name, (core,), (endpoint,), settings, stop=stop):
                while not stop.wait(0.2):
                    pass
        except TransientError:
            if not stop.is_set():
                raise


if __name__ == "__main__":
    main()
