"""Builds and parses the key expressions of the protocol (docs/design/protocol.md#keys). Opens no session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import NamedTuple

from schemas.protocol.messages import KEY_LAYOUT, MAX_MESSAGE_BYTES

MAX_CHUNK_BYTES = MAX_MESSAGE_BYTES
"""Largest size of the ranges in one reply, bytes."""
MAX_RANGES = 64
"""Largest number of ranges of bundles in one request."""
EVALUATION_PREFIX = "eval_"
"""Prefix of the name of an evaluation's run."""
EVALUATION_RUNS = f"{EVALUATION_PREFIX}$*"
"""Key expression that matches the runs of all evaluations."""


RANGE_FIELDS = ("job", "fence", "off", "n")
"""Parameters of a range of a bundle in a selector."""
_SEPARATOR = "|"
"""Separator of the values of several ranges, as in other selectors of zenoh."""
_MAX_FIELD_CHARS = 16 * MAX_RANGES


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


class BundleRange(NamedTuple):
    """Requested range of a spooled bundle."""

    job_id: int
    """Row of the job in the ledger."""
    fence: int
    """Fence of the lease."""
    chunk: Chunk
    """Range of the file."""


def _root(run: str) -> str:
    return f"factory/{run}/v{KEY_LAYOUT}"


def verb_key(run: str, host: str, verb: Verb) -> str:
    """Returns the key of a verb for one host; the key contains the host, so access control can check it."""
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
    """Returns whether a session id belongs to a host: it is `HOST`, or `HOST.` and a suffix that is new at each start.

    A host name has no dot, so a session id belongs to one host only.
    """
    # not a dash, with which a session of the host `a` could belong to a host `a-b`
    return "." not in host and (sid == host or sid.startswith(f"{host}."))


def host_of(sid: str) -> str:
    return sid.partition(".")[0]


def scene_key(run: str, sha256: str) -> str:
    """Returns the key under which the coordinator serves chunks of a compiled scene."""
    return f"{_root(run)}/scene/{sha256}"


def scene_pattern(run: str) -> str:
    """Returns the pattern of all compiled scenes of the run."""
    return scene_key(run, "*")


def scene_selector(run: str, sha256: str, chunk: Chunk) -> str:
    """Returns the selector of a chunk of a compiled scene; a reply is shorter than the chunk only at the end of the
    file."""
    return f"{scene_key(run, sha256)}?off={chunk.offset};n={chunk.length}"


def bundle_selector(run: str, sid: str, ranges: Sequence[BundleRange]) -> str:
    """Returns the selector of ranges of bundles in a worker's spool; the reply is their concatenation.

    Args:
        run: name of the run.
        sid: session id of the worker.
        ranges: at most `MAX_RANGES` ranges of at most `MAX_CHUNK_BYTES` in total.
    """
    rows = [(each.job_id, each.fence, *each.chunk) for each in ranges]
    columns = [_SEPARATOR.join(map(str, column)) for column in zip(*rows, strict=True)]
    where = ";".join(f"{name}={values}" for name, values in zip(RANGE_FIELDS, columns, strict=True))
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


def parse_bundle_ranges(parameters: Mapping[str, str]) -> tuple[BundleRange, ...]:
    """Parses the selector of ranges of bundles.

    Raises:
        ValueError: a parameter is missing or out of bounds, or the ranges together exceed a limit.
    """
    columns = [parameters.get(name, "")[:_MAX_FIELD_CHARS].split(_SEPARATOR) for name in RANGE_FIELDS]
    count = len(columns[0])
    if count > MAX_RANGES or any(len(column) != count for column in columns):
        raise ValueError(
            f"{[len(column) for column in columns]} values of {', '.join(RANGE_FIELDS)}; expected equal numbers, "
            f"at most {MAX_RANGES}"
        )
    bundle_ranges = tuple(_range_of(dict(zip(RANGE_FIELDS, row, strict=True))) for row in zip(*columns, strict=True))
    total = sum(each.chunk.length for each in bundle_ranges)
    if total > MAX_CHUNK_BYTES:
        raise ValueError(f"ranges of {total} bytes in total are not within 1..{MAX_CHUNK_BYTES} bytes")
    return bundle_ranges


def _range_of(parameters: Mapping[str, str]) -> BundleRange:
    return BundleRange(_number(parameters, "job"), _number(parameters, "fence"), parse_chunk(parameters))


def _number(parameters: Mapping[str, str], name: str) -> int:
    text = parameters.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) <= 15):
        raise ValueError(f"{name}={text[:20]!r} is not a number; expected a selector such as `?off=0;n=1048576`")
    return int(text)
