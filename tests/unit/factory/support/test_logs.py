"""Log output: one bounded line for each event, without values of local variables."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog

import factory
from factory.support.logs import MAX_FIELD_CHARS, configure_logs
from schemas.support.log_limit import LogLimit, describe_error

SECRET = "5ec2e7" * 5
ROOT = Path(factory.__file__).parents[1]


@pytest.fixture
def lines() -> Iterator[io.StringIO]:
    """Collects all log lines, with logging configured as in an entry point."""
    stream = io.StringIO()
    with contextlib.redirect_stderr(stream):
        configure_logs(verbose=True)
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(stream))
    yield stream
    structlog.reset_defaults()


def fail_with(token: str) -> None:
    message = {"token": token, "payload": b"x" * 1_000_000}
    raise OverflowError(f"{len(message)} parts")


def test_a_traceback_shows_no_local_variable(lines: io.StringIO) -> None:
    try:
        fail_with(SECRET)
    except OverflowError:
        structlog.get_logger("test").exception("failed")
    assert "OverflowError: 2 parts" in lines.getvalue()
    assert SECRET not in lines.getvalue()
    assert len(lines.getvalue()) < 2000


@pytest.mark.parametrize("value", ["x" * 1_000_000, b"x" * 1_000_000, ["x" * 9] * 100_000, {"x": "y" * 100_000}])
def test_the_length_of_a_logged_field_is_bounded_for_any_value(lines: io.StringIO, value: object) -> None:
    structlog.get_logger("test").warning("told", value=value)
    assert len(lines.getvalue()) < 2 * MAX_FIELD_CHARS


def test_text_of_a_peer_stays_on_one_line_without_control_characters(lines: io.StringIO) -> None:
    structlog.get_logger("test").warning("told", value="a\nb\x1b[31m\x9bc\r")
    assert lines.getvalue().count("\n") == 1
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", lines.getvalue())


def test_no_entry_point_logs_local_variables() -> None:
    configuring = [
        path
        for package in ("coordinator", "factory", "schemas", "workers")
        for path in (ROOT / package).rglob("*.py")
        if re.search("ConsoleRenderer|show_locals|RichTraceback", path.read_text())
    ]
    assert [path.name for path in configuring] == ["logs.py"]


def test_an_error_is_logged_in_one_short_line() -> None:
    try:
        fail_with(SECRET)
    except OverflowError as error:
        told = describe_error(error)
    assert re.fullmatch(r"OverflowError: 2 parts \(test_logs.py:\d+\)", told)
    assert len(describe_error(ValueError("a\n" * 100_000))) < 400


def test_repeated_lines_are_rate_limited_and_counted() -> None:
    now = [0.0]
    limit = LogLimit(1.0, clock=lambda: now[0])
    assert [limit.admit("a"), limit.admit("a"), limit.admit("b"), limit.admit("a")] == [0, None, 0, None]
    now[0] = 1.5
    assert limit.admit("a") == 2


def test_the_rate_limit_remembers_a_bounded_number_of_kinds() -> None:
    limit = LogLimit(1.0, clock=lambda: 0.0)
    for number in range(5000):
        assert limit.admit(f"host-{number}") == 0
    assert len(limit._kinds) <= 1000


def test_a_logger_works_after_its_first_stream_is_closed(capsys: pytest.CaptureFixture[str]) -> None:
    log = structlog.get_logger("long-lived")
    configure_logs()
    with contextlib.redirect_stderr(io.StringIO()) as first:
        log.warning("early")
    first.close()
    log.warning("late")
    assert "late" in capsys.readouterr().err
    structlog.reset_defaults()
