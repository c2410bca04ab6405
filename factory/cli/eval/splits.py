"""Option `--split` of `factory eval` and `factory eval specs`."""

from __future__ import annotations

from factory.cli.common.filters import split_filter
from schemas.terms import Split

eval_split_filter = split_filter(
    f"Split to include; repeatable. Values: {', '.join(Split)}, all. Default: the test splits."
)
"""`--split SPLIT`."""
