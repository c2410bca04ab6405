"""Selectors of ranges of bundles."""

from __future__ import annotations

import pytest

from schemas.protocol.keys import (
    MAX_CHUNK_BYTES,
    MAX_RANGES,
    BundleRange,
    Chunk,
    bundle_selector,
    parse_bundle_ranges,
)

TOO_MANY = "|".join(["1"] * (MAX_RANGES + 1))


def parse(selector: str) -> tuple[BundleRange, ...]:
    return parse_bundle_ranges(dict(field.split("=") for field in selector.partition("?")[2].split(";") if field))


@pytest.mark.parametrize("count", [1, 2, MAX_RANGES])
def test_ranges_of_a_selector_are_read_back(count: int) -> None:
    ranges = tuple(BundleRange(number + 1, 2, Chunk(number, 100 + number)) for number in range(count))
    assert parse(bundle_selector("demo", "host.1", ranges)) == ranges


def test_a_single_range_has_the_form_of_earlier_versions() -> None:
    selector = bundle_selector("demo", "host.1", [BundleRange(7, 2, Chunk(0, 10))])
    assert selector == "factory/demo/v1/w/host.1/ep?job=7;fence=2;off=0;n=10"


@pytest.mark.parametrize(
    ("selector", "message"),
    [
        ("?", "job='' is not a number"),
        ("?job=1;fence=1;off=0;n=1|2", "expected equal numbers"),
        ("?job=1|x;fence=1|1;off=0|0;n=1|1", "job='x' is not a number"),
        (f"?job=1|2;fence=1|1;off=0|0;n={MAX_CHUNK_BYTES}|1", "bytes in total"),
        (f"?job={TOO_MANY};fence={TOO_MANY};off={TOO_MANY};n={TOO_MANY}", "at most"),
        (f"?job={'1' * 5000};fence=1;off=0;n=1", "is not a number"),
    ],
)
def test_selectors_out_of_bounds_are_refused(selector: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse(selector)
