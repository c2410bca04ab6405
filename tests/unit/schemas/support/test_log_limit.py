"""Repeated events in the log: the first is logged at once, a few later ones are logged, and the end is logged."""

from __future__ import annotations

import errno
import os

import pytest
import structlog
from structlog.testing import capture_logs

from schemas.errors import WorldError
from schemas.support.log_limit import LogLimit, Repeated


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def failing(clock: Clock) -> Repeated:
    return Repeated(structlog.get_logger("test"), "write_failed", clock=clock)


ERRORS = [
    OSError(code, os.strerror(code)) for code in (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EMFILE, errno.EIO)
]


@pytest.mark.parametrize("error", [*ERRORS, WorldError("no inodes")], ids=str)
def test_failures_during_an_hour_are_logged_at_once_then_rarely_and_at_the_end(clock: Clock, error: Exception) -> None:
    trouble = failing(clock)
    with capture_logs() as lines:
        for clock.now in range(3600):
            trouble.fail(error)
        trouble.succeed()
        trouble.succeed()
    assert lines[0] == {"event": "write_failed", "log_level": "warning", "error": str(error)}
    assert len(lines) < 15
    assert lines[-2]["failures"] > 3000
    assert lines[-1] == {"event": "write_failed_recovered", "log_level": "warning", "failures": 3600, "after_s": 3599}


def test_repeated_lines_become_rare_and_count_the_omitted_ones(clock: Clock) -> None:
    limit, log = LogLimit(1.0, 60.0, clock), structlog.get_logger("test")
    with capture_logs() as lines:
        for clock.now in range(3600):
            limit.write(log.warning, "refused", "bad", host="bad")
        limit.write(log.warning, "refused", "good", host="good")
        clock.now = 10_000
        limit.write(log.warning, "refused", "bad", host="bad")
    assert len(lines) < 80
    assert lines[0] == {"event": "refused", "log_level": "warning", "host": "bad"}
    assert sum(1 + line.get("omitted", 0) for line in lines if line["host"] == "bad") == 3601
    assert lines[-2] == {"event": "refused", "log_level": "warning", "host": "good"}


def test_intermittent_failures_are_rate_limited(clock: Clock) -> None:
    trouble = failing(clock)
    with capture_logs() as lines:
        for clock.now in range(3600):
            trouble.fail("refused")
            trouble.succeed()
    assert 2 <= len(lines) < 30


def test_the_next_failure_after_a_quiet_time_is_logged_at_once(clock: Clock) -> None:
    trouble = failing(clock)
    with capture_logs() as lines:
        for clock.now in (0, 5000, 10000):
            trouble.fail("refused")
            trouble.succeed()
    assert [line["event"] for line in lines] == ["write_failed", "write_failed_recovered"] * 3


def test_an_unexpected_error_is_logged_with_one_traceback(clock: Clock) -> None:
    trouble = failing(clock)
    with capture_logs() as lines:
        for clock.now in (0, 20, 60):
            trouble.fail(KeyError("x"))
    assert [("exc_info" in line, line["log_level"]) for line in lines] == [
        (True, "error"),
        (False, "warning"),
        (False, "warning"),
    ]


def test_an_error_is_one_line(clock: Clock) -> None:
    trouble = failing(clock)
    with capture_logs() as lines:
        trouble.fail(WorldError("no room\nand a page of explanation"))
    assert lines[0]["error"] == "no room"


def _raised(error: Exception) -> Exception:
    try:
        raise error
    except type(error) as caught:
        return caught


def test_the_same_error_of_this_software_ends_the_loop_after_a_few_repetitions(clock: Clock) -> None:
    trouble = failing(clock)
    for number in range(4):
        trouble.fail(_raised(KeyError(number)))
    trouble.require_no_fault()
    trouble.fail(_raised(KeyError("last")))
    with pytest.raises(RuntimeError, match=r"write_failed 5 times by the same error: KeyError: 0 \(test_log_limit"):
        trouble.require_no_fault()


@pytest.mark.parametrize("between", [None, WorldError("disk full"), OSError("no route"), MemoryError(), "refused"])
def test_errors_from_outside_and_successes_do_not_end_the_loop(
    clock: Clock, between: BaseException | str | None
) -> None:
    trouble = failing(clock)
    for _ in range(20):
        for _ in range(4):
            trouble.fail(_raised(KeyError("x")))
        if between is None:
            trouble.succeed()
        else:
            for _ in range(9):
                trouble.fail(between)
    trouble.require_no_fault()
