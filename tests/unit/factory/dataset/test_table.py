"""Tables of a dataset whose values Python cannot represent."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from factory.dataset.columns import read_table

LARGEST, SMALLEST = 2**63 - 1, -(2**63)


@pytest.mark.parametrize("zone", ["UTC", None])
@pytest.mark.parametrize(("unit", "is_always_valid"), [("s", False), ("ms", False), ("us", False), ("ns", True)])
def test_a_timestamp_out_of_range_becomes_null(
    tmp_path: Path, unit: str, zone: str | None, is_always_valid: bool
) -> None:
    kind = pa.timestamp(unit, tz=zone)
    values = pa.array([LARGEST, SMALLEST, 0, None], pa.int64()).cast(kind)
    if unit == "s":  # Parquet stores milliseconds, which cannot express the extreme seconds
        values = pa.array([2**53, -(2**53), 0, None], pa.int64()).cast(kind)
    pq.write_table(pa.table({"at": values, "other": [1, 2, 3, 4]}), tmp_path / "table.parquet")
    table = read_table(tmp_path / "table.parquet", ["at"])
    assert table.column_names == ["at"]
    assert [value.is_valid for value in table["at"]] == [is_always_valid, is_always_valid, True, False]
    assert table["at"][2].as_py().replace(tzinfo=UTC) == datetime(1970, 1, 1, tzinfo=UTC)
