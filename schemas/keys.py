"""Key expressions of the protocol: who answers where (docs/design/protocol.md#keys). Builds strings, opens nothing."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import NamedTuple

from schemas.wire import MAX_MESSAGE_BYTES, PROTOCOL, Lease

__all__ = [
    "EVALUATION_PREFIX",
    "EVALUATION_RUNS",
    "MAX_CHUNK_BYTES",
    "BundleChunk",
    "Chunk",
    "Verb",
    "alive_key",
    "alive_pattern",
    "any_hello_key",
    "bundle_key",
    "bundle_selector",
    "host_of",
    "parse_bundle_chunk",
    "parse_chunk",
    "scene_key",
    "scene_pattern",
    "scene_selector",
    "sid_belongs_to",
    "sid_of_alive_key",
    "verb_key",
    "verb_pattern",
]

MAX_CHUNK_BYTES = MAX_MESSAGE_BYTES
"""Most bytes of a file that one reply carries."""
EVALUATION_PREFIX = "eval_"
"""How the name of an evaluation's run begins."""
EVALUATION_RUNS = f"{EVALUATION_PREFIX}$*"
"""In the place of a run: every evaluation's."""


class Verb(StrEnum):
    """What may be asked of the coordinator."""

    HELLO = "hello"
    CLAIM = "claim"
    BEAT = "beat"
    DONE = "done"
    FAIL = "fail"
    PROGRESS = "progress"
    ADMIN = "admin"
    PING = "ping"  # says that a coordinator is there, and nothing of its run

    JOIN = "join"  # from here on what gateways ask
    ORDERS = "orders"
    HOLD = "hold"
    ARCHIVED = "archived"
    REFUSED = "refused"
    INVENTORY = "inventory"


class Chunk(NamedTuple):
    """Which bytes of a file are asked for."""

    offset: int
    length: int


class BundleChunk(NamedTuple):
    """Which bytes of which spooled bundle are asked for."""

    job_id: int
    fence: int
    chunk: Chunk


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


def sid_belongs_to(sid: str, host: str) -> bool:
    """Whether a worker of that host may call itself so: `HOST` or `HOST.` and whatever tells its starts apart.

    A host's name has no dot, so that no host's sessions look like another's, whatever the two are called.
    """
    return "." not in host and (sid == host or sid.startswith(f"{host}."))


def host_of(sid: str) -> str:
    """Returns the host of a session id."""
    return sid.partition(".")[0]


def scene_key(run: str, sha256: str) -> str:
    """Where the coordinator serves chunks of a compiled scene."""
    return f"{_root(run)}/scene/{sha256}"


def scene_pattern(run: str) -> str:
    """All compiled scenes of the run."""
    return scene_key(run, "*")


def scene_selector(run: str, sha256: str, chunk: Chunk) -> str:
    """Asks for a chunk of a compiled scene; the answer is shorter than asked only at the end of the file."""
    return f"{scene_key(run, sha256)}?off={chunk.offset};n={chunk.length}"


def bundle_selector(run: str, sid: str, lease: Lease, chunk: Chunk) -> str:
    """Asks for a chunk of the bundle that waits in a worker's spool under a lease."""
    where = f"job={lease.job_id};fence={lease.fence};off={chunk.offset};n={chunk.length}"
    return f"{bundle_key(run, sid)}?{where}"


def parse_chunk(parameters: Mapping[str, str]) -> Chunk:
    """Reads `off` and `n` of a selector.

    Raises:
        ValueError: one is missing, no number, negative, or `n` is above `MAX_CHUNK_BYTES`.
    """
    offset, length = _number(parameters, "off"), _number(parameters, "n")
    if not 0 < length <= MAX_CHUNK_BYTES:
        raise ValueError(f"n={length} is not within 1..{MAX_CHUNK_BYTES} bytes")
    return Chunk(offset, length)


def parse_bundle_chunk(parameters: Mapping[str, str]) -> BundleChunk:
    """Reads the selector of a bundle's chunk.

    Raises:
        ValueError: a number is missing or out of bounds.
    """
    return BundleChunk(_number(parameters, "job"), _number(parameters, "fence"), parse_chunk(parameters))


def _number(parameters: Mapping[str, str], name: str) -> int:
    text = parameters.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) <= 15):
        raise ValueError(f"{name}={text[:20]!r} is not a number; expected a selector such as `?off=0;n=1048576`")
    return int(text)
