"""The settings of zenoh sessions, measured in notes/zenoh.md: router for the coordinator, client for its operators.

Builds configurations; opens nothing. Bulk travels in chunks, so that no message needs to be large.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import zenoh

from coordinator.settings import TlsFiles
from schemas.keys import Verb
from schemas.wire import PROTOCOL

__all__ = ["client_config", "router_config"]

_MAX_MESSAGE_BYTES = 4 << 20
_MAX_SESSIONS, _MAX_ARRIVING = 5000, 1000
_CONNECT_TIMEOUT_MS = 2000


def router_config(listen: Sequence[str], lease_s: float, tls: TlsFiles | None) -> zenoh.Config:
    """Returns the configuration of the coordinator's session, which is the router of the run.

    Args:
        listen: endpoints such as `tcp/0.0.0.0:7447`.
        lease_s: silence after which a link is closed.
        tls: certificates and who may do what; `None` lets everyone in who can connect.
    """
    values = _common("router", lease_s) | {
        "listen/endpoints": json.dumps(list(listen)),
        "transport/unicast/max_sessions": str(_MAX_SESSIONS),
        "transport/unicast/accept_pending": str(_MAX_ARRIVING),
    }
    if tls is not None:
        values |= _tls(tls, "listen") | {"access_control": json.dumps(_access(tls))}
    return _config(values)


def client_config(connect: Sequence[str], lease_s: float, tls: TlsFiles | None) -> zenoh.Config:
    """Returns the configuration of a client that gives up connecting after two seconds."""
    values = _common("client", lease_s) | {
        "listen/endpoints": "[]",
        "connect/endpoints": json.dumps(list(connect)),
        "connect/timeout_ms": str(_CONNECT_TIMEOUT_MS),
        "connect/exit_on_failure": "true",
    }
    if tls is not None:
        values |= _tls(tls, "connect")
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


def _tls(tls: TlsFiles, side: str) -> dict[str, str]:
    return {
        "transport/link/protocols": '["tls"]',
        "transport/link/tls/root_ca_certificate": json.dumps(str(tls.ca)),
        "transport/link/tls/enable_mtls": "true",
        "transport/link/tls/close_link_on_expiration": "true",
        f"transport/link/tls/{side}_private_key": json.dumps(str(tls.key)),
        f"transport/link/tls/{side}_certificate": json.dumps(str(tls.certificate)),
    }


def _access(tls: TlsFiles) -> dict[str, object]:
    """Returns default-deny access control: a host asks under its own name and answers in its own subtree only."""
    root = f"factory/*/v{PROTOCOL}"
    rules: list[dict[str, object]] = [
        _rule("see", "egress", ["declare_queryable"], [f"{root}/**"]),
        _rule("scenes-ask", "ingress", ["query"], [f"{root}/scene/*"]),
        _rule("scenes-answer", "egress", ["reply"], [f"{root}/scene/*"]),
    ]
    policies: list[dict[str, object]] = []
    verbs: dict[str, list[Verb]] = {name: [verb for verb in Verb if verb is not Verb.ADMIN] for name in tls.hosts}
    verbs |= {name: [Verb.HELLO, Verb.PROGRESS, Verb.ADMIN] for name in tls.operators}
    for name, allowed in verbs.items():
        asks = [f"{root}/c/{name}/{verb}" for verb in allowed]
        mine = [f"{root}/w/{name}/**", f"{root}/w/{name}-$*/**"]
        rules += [
            _rule(f"ask-{name}", "ingress", ["query"], asks),
            _rule(f"answer-{name}", "egress", ["reply"], asks),
            _rule(f"own-{name}", "ingress", ["declare_queryable", "reply", "liveliness_token"], mine),
            _rule(f"asked-{name}", "egress", ["query"], mine),
        ]
        own = ["own-" + name, "asked-" + name, "scenes-ask", "scenes-answer"] if name in tls.hosts else []
        policies.append({"rules": ["see", f"ask-{name}", f"answer-{name}", *own], "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in verbs],
        "policies": policies,
    }


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, object]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}
