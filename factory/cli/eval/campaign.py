"""Builds the campaign and opens the result store of `factory eval` from its options, with progress bars."""

from __future__ import annotations

from factory.cli.common.filters import split_filter
from schemas.terms import Split

eval_split_filter = split_filter(
    f"Split to include; repeatable. Values: {', '.join(Split)}, all. Default: the test splits."
)
"""`--split SPLIT`."""
