"""The settings of zenoh sessions, measured in notes/zenoh.md: router for the coordinator, client for its operators.

Builds configurations; opens nothing. Bulk travels in chunks, so that no message needs to be large.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import zenoh

__all__ = ["client_config", "router_config"]

_MAX_MESSAGE_BYTES = 4 << 20
_MAX_SESSIONS, _MAX_ARRIVING = 5000, 1000
_CONNECT_TIMEOUT_MS = 2000


def router_config(listen: Sequence[str], lease_s: float) -> zenoh.Config:
    """Returns the configuration of the coordinator's session, which is the router of the run.

    Args:
        listen: endpoints such as `tcp/0.0.0.0:7447`.
        lease_s: silence after which a link is closed.
    """
    values = _common("router", lease_s) | {
        "listen/endpoints": json.dumps(list(listen)),
        "transport/unicast/max_sessions": str(_MAX_SESSIONS),
        "transport/unicast/accept_pending": str(_MAX_ARRIVING),
    }
    return _config(values)


def client_config(connect: Sequence[str], lease_s: float) -> zenoh.Config:
    """Returns the configuration of a client that gives up connecting after two seconds."""
    values = _common("client", lease_s) | {
        "listen/endpoints": "[]",
        "connect/endpoints": json.dumps(list(connect)),
        "connect/timeout_ms": str(_CONNECT_TIMEOUT_MS),
        "connect/exit_on_failure": "true",
    }
    return _config(values)


def _config(values: dict[str, str]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, value)
    return config


def _common(mode: str, lease_s: float) -> dict[str, str]:
    return {
        "mode": json.dumps(mode),
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "false",
        # shared memory loses queries under load and leaves files behind when a process is killed
        "transport/shared_memory/enabled": "false",
        "transport/link/tx/lease": str(round(1000 * lease_s)),
        "transport/link/rx/max_message_size": str(_MAX_MESSAGE_BYTES),
        "queries_default_timeout": "5000",
    }
