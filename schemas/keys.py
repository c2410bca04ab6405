"""Key expressions of the protocol: who answers where (DESIGN 9). Builds strings, opens nothing."""

from __future__ import annotations

from enum import StrEnum

from schemas.wire import PROTOCOL

__all__ = [
    "Verb",
    "alive_key",
    "alive_pattern",
    "any_hello_key",
    "bundle_key",
    "scene_key",
    "sid_of_alive_key",
    "verb_key",
    "verb_pattern",
]


class Verb(StrEnum):
    """What a worker may ask of the coordinator."""

    HELLO = "hello"
    CLAIM = "claim"
    BEAT = "beat"
    DONE = "done"
    FAIL = "fail"
    PROGRESS = "progress"


def _root(run: str) -> str:
    return f"factory/{run}/v{PROTOCOL}"


def verb_key(run: str, host: str, verb: Verb) -> str:
    """Key of one verb as asked by one host; the host stands in the key so that a certificate can bind it."""
    return f"{_root(run)}/c/{host}/{verb}"


def verb_pattern(run: str) -> str:
    """What the coordinator answers."""
    return f"{_root(run)}/c/*/*"


def any_hello_key(host: str, verb: Verb = Verb.HELLO) -> str:
    """Key by which a client that does not know the run yet finds it."""
    return verb_key("*", host, verb)


def bundle_key(run: str, sid: str) -> str:
    """Where a worker serves chunks of its spool."""
    return f"{_root(run)}/w/{sid}/ep"


def alive_key(run: str, sid: str) -> str:
    """Liveliness token of a worker."""
    return f"{_root(run)}/w/{sid}/alive"


def alive_pattern(run: str) -> str:
    """All liveliness tokens of the run."""
    return f"{_root(run)}/w/*/alive"


def sid_of_alive_key(key: str) -> str:
    """Returns the worker's session id in the key of its token."""
    return key.split("/")[-2]


def scene_key(run: str, sha256: str) -> str:
    """Where the coordinator serves chunks of a compiled scene."""
    return f"{_root(run)}/scene/{sha256}"
