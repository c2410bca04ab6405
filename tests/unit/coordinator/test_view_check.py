"""A run ends when the camera of most attempts shows nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from datetime import UTC, datetime
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from coordinator import housekeeping
from coordinator.housekeeping import FreeSpaceMonitor, Housekeeping
from schemas.errors import WorldError


def checked(monkeypatch: pytest.MonkeyPatch, counts: Iterable[Mapping[str, int]]) -> Housekeeping:
    """Returns housekeeping that has read each of these numbers of attempts by outcome."""
    run = SimpleNamespace(
        ledger=SimpleNamespace(reading=lambda: nullcontext(None), writer=Mock()),
        clock=lambda: datetime(2026, 1, 1, tzinfo=UTC),
        terms=None,
        settings=SimpleNamespace(lease_limit_s=1.0),
    )
    tasks = Housekeeping(run, FreeSpaceMonitor(0), lambda: 0.0)  # type: ignore[arg-type]
    for tried in counts:
        monkeypatch.setattr(housekeeping, "count_attempts", lambda _connection, tried=tried: dict(tried))
        tasks.check_views()
    return tasks


def test_most_attempts_without_a_view_end_the_run_with_the_reason_and_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tasks = checked(monkeypatch, [{}, {"no_view": 20, "success": 19}])
    with pytest.raises(WorldError, match=r"20 of 39 attempts failed because the camera shows nothing.*`\[camera\]`"):
        tasks.require_view()


@pytest.mark.parametrize("after", [{"no_view": 19}, {"no_view": 20, "success": 20}, {"timeout": 50}])
def test_few_attempts_without_a_view_do_not_end_the_run(
    monkeypatch: pytest.MonkeyPatch, after: Mapping[str, int]
) -> None:
    checked(monkeypatch, [{}, after]).require_view()


def test_attempts_before_the_start_of_the_coordinator_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    checked(monkeypatch, [{"no_view": 500}, {"no_view": 510, "success": 5}]).require_view()
