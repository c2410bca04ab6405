"""All data from peers has bounds: every number, text, list and map of every model at any depth."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from typing import Annotated, Any

import pytest
from pydantic import Field, TypeAdapter, ValidationError, create_model

import coordinator.protocol.relay
import schemas.protocol.messages
from coordinator.protocol.protocol import ParsedRequest, parse
from coordinator.protocol.relay import MAX_FILES, Inventory, OrdersRequest, Refused
from coordinator.protocol.relay_handlers import RELAY_MESSAGES
from coordinator.validation.messages import Verdict
from schemas.base import MAX_COUNT, MAX_ROWS, Model
from schemas.episode import EpisodeMeta
from schemas.protocol.messages import MAX_LEASES, Beat, Done, Fail, Lease, LeaseProgress, Refusal, SpooledBundle
from schemas.scene import SceneInfo
from schemas.terms import FailReason
from workers.process.messages import SimulationReport

WITHOUT_END = ("*", "+", ",}")
NUMBER_BOUNDS = ("le", "lt"), ("ge", "gt")
COLLECTIONS = {"list", "set", "frozenset", "dict", "bytes"}
NOT_WALKED = {"metadata", "default", "serialization", "cls", "config", "expected", "members"}
LEASE = {"job_id": 1, "fence": 1, "token": "0" * 32}


def models_of(module: Any) -> set[type[Model]]:
    found = (item for _, item in inspect.getmembers(module, inspect.isclass))
    return {item for item in found if issubclass(item, Model) and item is not Model}


RECEIVED = sorted(
    {
        *models_of(schemas.protocol.messages),
        *models_of(coordinator.protocol.relay),
        EpisodeMeta,
        SceneInfo,
        Verdict,
        SimulationReport,
        SpooledBundle,
    },
    key=lambda model: model.__name__,
)
"""Models of data from other processes; nested models are checked too."""


def unbounded(schema: Any, place: str) -> Iterator[str]:
    """Yields the places at which a core schema of pydantic has no bound."""
    if isinstance(schema, list | tuple):
        for number, part in enumerate(schema):
            yield from unbounded(part, f"{place}[{number}]")
    if not isinstance(schema, dict):
        return
    kind = schema.get("type")
    if isinstance(kind, str):
        yield from (f"{place}: {why}" for why in shortcomings(kind, schema))
    for key, part in schema.items():
        if key not in NOT_WALKED:
            yield from unbounded(part, place if key in {"schema", "fields"} else f"{place}.{key}")


def shortcomings(kind: str, schema: Any) -> Iterator[str]:
    if kind in {"int", "float"}:
        for names in NUMBER_BOUNDS:
            if not any(name in schema for name in names):
                yield f"{kind} without {' or '.join(names)}"
    elif kind == "str":
        pattern = schema.get("pattern", "*")
        is_whole = pattern.startswith("^") and pattern.endswith("$")
        if "max_length" not in schema and (not is_whole or any(mark in pattern for mark in WITHOUT_END)):
            yield "text without max_length"
    elif kind == "any":
        yield "anything at all"
    elif "max_length" not in schema and (kind in COLLECTIONS or schema.get("variadic_item_index") is not None):
        yield f"{kind} without max_length"


@pytest.mark.parametrize("model", RECEIVED, ids=lambda model: model.__name__)
def test_every_number_text_list_and_map_that_is_received_has_a_bound(model: type[Model]) -> None:
    assert list(unbounded(TypeAdapter(model).core_schema, model.__name__)) == []


@pytest.mark.parametrize(
    "kind",
    [
        int,
        Annotated[int, Field(ge=1)],
        Annotated[float, Field(le=1)],
        str,
        Annotated[str, Field(pattern="^a*$")],
        tuple[bool, ...],
        list[bool],
        dict[bool, bool],
        Any,
        Annotated[tuple[str, ...], Field(max_length=3)],
        Annotated[dict[bool, int], Field(max_length=3)],
    ],
    ids=str,
)
def test_the_check_finds_unbounded_fields(kind: Any) -> None:
    inner = create_model("Inner", __base__=Model, value=(kind | None, None))
    outer = create_model("Outer", __base__=Model, parts=(tuple[inner, bool], ...))  # type: ignore[valid-type]
    assert list(unbounded(TypeAdapter(outer).core_schema, "Outer"))


@pytest.mark.parametrize("number", [10**15, 2**63, 2**64, 10**400, -1, 0])
@pytest.mark.parametrize("field", ["job_id", "fence"])
def test_a_number_beyond_the_column_range_is_refused(field: str, number: int) -> None:
    with pytest.raises(ValidationError):
        Lease.model_validate_json(json.dumps(LEASE | {field: number}))


def test_a_text_that_databases_cannot_store_is_refused() -> None:
    with pytest.raises(ValidationError):
        Fail.model_validate({"sid": "a", "lease": LEASE, "reason": "crash", "detail": "a\0b"})


@pytest.mark.parametrize("verb", ["hello", "claim", "beat", "done", "fail", *map(str, RELAY_MESSAGES)])
@pytest.mark.parametrize(
    "payload",
    [
        b"[" * 10_000,
        json.dumps({f"field{number}": number for number in range(900)}).encode(),
        json.dumps({"live": [{}] * 4000, "spool": [7] * 4000}).encode(),
        json.dumps({"sid": "x" * 15_000}).encode(),
        json.dumps({"x" * 15_000: 1}).encode(),
        b'{"job_id": ' + b"9" * 10_000 + b"}",
        b"\xff" * 1000,
        b"",
    ],
    ids=["deep", "surplus", "many", "long text", "long name", "digits", "bytes", "empty"],
)
def test_a_refusal_message_is_short_for_any_input(verb: str, payload: bytes) -> None:
    refusal = parse(verb, "host", payload, RELAY_MESSAGES if verb in RELAY_MESSAGES else None)
    assert isinstance(refusal, Refusal)
    assert len(refusal.error) < 1500


@pytest.mark.parametrize("host", ["", "h" * 49, "a.b", "UPPER", "a" * 1_000_000, "sp ace"], ids=lambda host: host[:9])
def test_an_invalid_host_name_is_refused_and_shortened_in_the_message(host: str) -> None:
    refusal = parse("claim", host, b"{}")
    assert isinstance(refusal, Refusal)
    assert "not a valid host name" in refusal.error
    assert len(refusal.error) < 200


def test_a_heartbeat_with_too_many_leases_is_refused() -> None:
    leases = [LEASE | {"job_id": number} for number in range(1, 400)]
    with pytest.raises(ValidationError, match="at most 256"):
        Beat.model_validate({"sid": "a", "spool": leases})


def test_the_largest_honest_messages_are_read() -> None:
    lease = Lease(job_id=MAX_ROWS, fence=MAX_COUNT, token="f" * 32)
    sid = "h" * 48 + "." + "f" * 8
    live = tuple(LeaseProgress(lease=lease, step=MAX_COUNT) for _ in range(MAX_LEASES))
    messages = {
        "beat": Beat(sid=sid, live=live, spool=(lease,) * MAX_LEASES, via="f" * 32),
        "fail": Fail(sid=sid, lease=lease, reason=FailReason.CRASH, detail='{"a": 1}' * 250, seconds=1e9),
        "done": Done(sid=sid, lease=lease, sha256="f" * 64, size=1 << 40, via="f" * 32),
        "inventory": Inventory(first=1, last=MAX_COUNT, files=((MAX_COUNT, 1 << 40),) * MAX_FILES),
        "orders": OrdersRequest(router="f" * 32, most=64, busy=("h" * 48,) * 64),
        "refused": Refused(sid=sid, lease=lease, detail="\N{SNOWMAN}" * 2000),
    }
    for verb, message in messages.items():
        known = RELAY_MESSAGES if verb in RELAY_MESSAGES else None
        request = parse(verb, "h" * 48, message.model_dump_json().encode(), known)
        assert isinstance(request, ParsedRequest), (verb, request)
        assert request.message == message
