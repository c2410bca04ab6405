"""Builds zenoh configurations: router for coordinators and gateways, client for admin commands.

Reasons: docs/design/protocol.md#zenoh-settings.

The module opens no session. Bundles are transferred in chunks, so no message needs to be large.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import zenoh

from coordinator.protocol.access import access_control
from schemas.protocol.identity import Role, TlsFiles

_MAX_MESSAGE_BYTES = 4 << 20
_MAX_SESSIONS, _MAX_PENDING_CONNECTIONS = 5000, 4000
"""Maximum number of sessions, and maximum number of connections that have no session yet. Beyond the maximum of such
connections, zenoh closes every new connection immediately, even that of a legitimate client."""
_HANDSHAKE_TIMEOUT_MS = 1000
"""Timeout of the handshake of a new connection, milliseconds. The handshake takes two round trips, and a client that is
too slow reconnects. With zenoh's default of 10 s, 1,500 idle connections blocked all clients for 13 s."""
_CONNECT_TIMEOUT_MS, _OPEN_TIMEOUT_MS = 2000, 2000
"""Timeout of connecting, and timeout of opening a link, milliseconds. Closing a session waits for a reconnect in
progress. A reconnect to a frozen router takes as long as the timeout of opening a link; zenoh's default is 10 s."""


def router_config(
    listen: Sequence[str],
    lease_s: float,
    tls: TlsFiles | None = None,
    admitted: Mapping[str, Role] | None = None,
    connect: Sequence[str] = (),
) -> zenoh.Config:
    """Returns the configuration of the router session of a coordinator or gateway.

    Args:
        listen: endpoints such as `tcp/0.0.0.0:7447`.
        lease_s: time without traffic after which zenoh closes a link, seconds.
        tls: TLS files for listening and connecting, with mutual authentication; `None` for plain TCP.
        admitted: admission list with TLS: role by common name; all other peers have no permissions.
        connect: endpoints of the core of a gateway or an evaluation; a lost link is reconnected.
    """
    values = _common("router", lease_s) | {
        "listen/endpoints": json.dumps([_with_deadline(endpoint) for endpoint in listen]),
        "connect/endpoints": json.dumps(list(connect)),
        "connect/retry": json.dumps({"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 2}),
        "transport/unicast/max_sessions": str(_MAX_SESSIONS),
        "transport/unicast/accept_pending": str(_MAX_PENDING_CONNECTIONS),
        "transport/unicast/accept_timeout": str(_HANDSHAKE_TIMEOUT_MS),
        "transport/unicast/open_timeout": str(_OPEN_TIMEOUT_MS),
    }
    if not connect:
        values["scouting/delay"] = "0"  # zenoh's default delays opening a session without `connect` by 0.5 s
    if tls is not None and listen:
        values |= _tls(tls, "listen") | {"access_control": json.dumps(access_control(admitted or {}))}
    if tls is not None and connect:
        values |= _tls(tls, "connect")
    return _config(values)


def client_config(connect: Sequence[str], lease_s: float, tls: TlsFiles | None = None) -> zenoh.Config:
    """Returns the configuration of a client, with a connection timeout of two seconds."""
    values = _common("client", lease_s) | {
        "listen/endpoints": "[]",
        "connect/endpoints": json.dumps(list(connect)),
        "connect/timeout_ms": str(_CONNECT_TIMEOUT_MS),
        "connect/exit_on_failure": "true",
        "transport/unicast/open_timeout": str(_OPEN_TIMEOUT_MS),
    }
    if tls is not None:
        values |= _tls(tls, "connect")
    return _config(values)


def _with_deadline(endpoint: str) -> str:
    """Adds the timeout of the TLS handshake to an endpoint; zenoh has no separate setting for it."""
    if not endpoint.startswith("tls/"):
        return endpoint
    return f"{endpoint}{';' if '#' in endpoint else '#'}tls_handshake_timeout_ms={_HANDSHAKE_TIMEOUT_MS}"


def _config(values: dict[str, str]) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, value)
    return config


def _tls(tls: TlsFiles, side: str) -> dict[str, str]:
    return {
        "transport/link/protocols": '["tls"]',
        "transport/link/tls/root_ca_certificate": json.dumps(str(tls.ca)),
        "transport/link/tls/enable_mtls": "true",
        "transport/link/tls/verify_name_on_connect": "true",
        "transport/link/tls/close_link_on_expiration": "true",
        f"transport/link/tls/{side}_private_key": json.dumps(str(tls.key)),
        f"transport/link/tls/{side}_certificate": json.dumps(str(tls.certificate)),
    }


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
