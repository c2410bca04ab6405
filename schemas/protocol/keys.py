"""Builds and parses the key expressions of the protocol (docs/design/protocol.md#keys). Opens no session."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

from schemas.protocol.messages import MAX_MESSAGE_BYTES, PROTOCOL, Lease

MAX_CHUNK_BYTES = MAX_MESSAGE_BYTES
"""Largest part of a file in one reply, bytes."""
EVALUATION_PREFIX = "eval_"
"""Prefix of the name of an evaluation's run."""
EVALUATION_RUNS = f"{EVALUATION_PREFIX}$*"
"""Key expression that matches the runs of all evaluations."""


class Verb(StrEnum):
    """Requests that a coordinator serves."""

    HELLO = "hello"
    CLAIM = "claim"
    BEAT = "beat"
    DONE = "done"
    FAIL = "fail"
    PROGRESS = "progress"
    ADMIN = "admin"
    PING = "ping"  # checks that a coordinator answers, without information about its run

    JOIN = "join"  # this verb and those below are sent by gateways
    ORDERS = "orders"
    HOLD = "hold"
    ARCHIVED = "archived"
    REFUSED = "refused"
    INVENTORY = "inventory"


class Chunk(NamedTuple):
    """Requested range of a file."""

    offset: int
    """First byte of the range."""
    length: int
    """Number of bytes."""


class BundleChunk(NamedTuple):
    """Requested range of a spooled bundle."""

    job_id: int
    """Row of the job in the ledger."""
    fence: int
    """Fence of the lease."""
    chunk: Chunk
    """Range of the file."""


def _root(run: str) -> str:
    return f"factory/{run}/v{PROTOCOL}"


def verb_key(run: str, host: str, verb: Verb) -> str:
    """Returns the key of a verb for one host; the key contains the host, so that access control can check it."""
    return f"{_root(run)}/c/{host}/{verb}"


def verb_pattern(run: str) -> str:
    """Returns the pattern of all keys that a coordinator serves."""
    return f"{_root(run)}/c/*/*"


def any_hello_key(host: str, verb: Verb = Verb.HELLO) -> str:
    """Returns the key that a client uses to find a run whose name it does not know."""
    return verb_key("*", host, verb)


def bundle_key(run: str, sid: str) -> str:
    """Returns the key under which a worker serves chunks of its spool."""
    return f"{_root(run)}/w/{sid}/ep"


def alive_key(run: str, sid: str) -> str:
    """Returns the key of a worker's liveliness token."""
    return f"{_root(run)}/w/{sid}/alive"


def alive_pattern(run: str) -> str:
    """Returns the pattern of all liveliness tokens of the run."""
    return f"{_root(run)}/w/*/alive"


def sid_of_alive_key(key: str) -> str:
    """Returns the worker's session id from the key of its liveliness token."""
    return key.split("/")[-2]


def sid_belongs_to(sid: str, host: str) -> bool:
    """Returns whether a session id belongs to a host: it is `HOST`, or `HOST.` and a suffix for each start.

    A host name has no dot, so a session id belongs to one host only.
    """
    return "." not in host and (sid == host or sid.startswith(f"{host}."))


def host_of(sid: str) -> str:
    """Returns the host of a session id."""
    return sid.partition(".")[0]


def scene_key(run: str, sha256: str) -> str:
    """Returns the key under which the coordinator serves chunks of a compiled scene."""
    return f"{_root(run)}/scene/{sha256}"


def scene_pattern(run: str) -> str:
    """Returns the pattern of all compiled scenes of the run."""
    return scene_key(run, "*")


def scene_selector(run: str, sha256: str, chunk: Chunk) -> str:
    """Returns the selector of a chunk of a compiled scene; the reply is shorter only at the end of the file."""
    return f"{scene_key(run, sha256)}?off={chunk.offset};n={chunk.length}"


def bundle_selector(run: str, sid: str, lease: Lease, chunk: Chunk) -> str:
    """Returns the selector of a chunk of the bundle that a worker's spool holds under a lease."""
    where = f"job={lease.job_id};fence={lease.fence};off={chunk.offset};n={chunk.length}"
    return f"{bundle_key(run, sid)}?{where}"


def parse_chunk(parameters: Mapping[str, str]) -> Chunk:
    """Parses `off` and `n` of a selector.

    Raises:
        ValueError: a parameter is missing, not a number or negative, or `n` is not in 1..`MAX_CHUNK_BYTES`.
    """
    offset, length = _number(parameters, "off"), _number(parameters, "n")
    if not 0 < length <= MAX_CHUNK_BYTES:
        raise ValueError(f"n={length} is not within 1..{MAX_CHUNK_BYTES} bytes")
    return Chunk(offset, length)


def parse_bundle_chunk(parameters: Mapping[str, str]) -> BundleChunk:
    """Parses the selector of a bundle's chunk.

    Raises:
        ValueError: a parameter is missing or out of bounds.
    """
    return BundleChunk(_number(parameters, "job"), _number(parameters, "fence"), parse_chunk(parameters))


def _number(parameters: Mapping[str, str], name: str) -> int:
    text = parameters.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) <= 15):
        raise ValueError(f"{name}={text[:20]!r} is not a number; expected a selector such as `?off=0;n=1048576`")
    return int(text)
