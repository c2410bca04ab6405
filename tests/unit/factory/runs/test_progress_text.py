"""Watching a run: a short outage of the coordinator is retried, a long one ends the watch."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from io import StringIO

import pytest
from rich.console import Console

from coordinator.expansion.plan_file import load_plan
from factory.runs.progress_text import draw_progress, watch_progress
from factory.runs.summary import RunBar
from factory.support.terminal import stdout
from schemas.errors import TransientError
from schemas.protocol.status import Progress, WorkerStatus


def progress(archived: int) -> Progress:
    return Progress(
        run="demo-1",
        planned=3,
        jobs={"archived": archived, "pending": 3 - archived},
        by_scene={},
        by_tier={},
        by_split={},
        redrawn=0,
        attempts={},
        workers=(),
        episodes_per_hour=None,
        eta_s=None,
        finished=archived == 3,
    )


def telling(answers: Iterable[int | None]) -> Callable[[], Progress]:
    """Returns a source that returns each answer in turn; `None` means that no answer arrives."""
    left = iter(answers)

    def source() -> Progress:
        answer = next(left)
        if answer is None:
            raise TransientError("no coordinator answers")
        return progress(answer)

    return source


def test_returned_jobs_do_not_count_as_failed_attempts(capsys: pytest.CaptureFixture[str]) -> None:
    tried = progress(1).model_copy(update={"attempts": {"success": 1, "released": 2, "timeout": 3}})
    stdout.print(draw_progress(tried))
    assert "failed attempts: 3 timeout; returned jobs: 2; redrawn targets: 0" in capsys.readouterr().out
    assert (tried.failures, tried.given_back) == ({"timeout": 3}, 2)
    assert tried.model_dump()["attempts"] == {"success": 1, "released": 2, "timeout": 3}


@pytest.mark.parametrize(
    ("layers", "said"),
    [
        ((), ""),
        (("rlimits", "seccomp"), "validator sandbox: rlimits, seccomp\n"),
        (("rlimits",), "validator sandbox: rlimits only; install the extra"),
    ],
)
def test_status_shows_the_validator_sandbox(
    capsys: pytest.CaptureFixture[str], layers: tuple[str, ...], said: str
) -> None:
    told = progress(1).model_copy(update={"sandbox": layers})
    stdout.print(draw_progress(told))
    shown = capsys.readouterr().out
    assert said in shown
    assert ("validator sandbox" in shown) == bool(layers)
    assert told.model_dump(mode="json")["sandbox"] == list(layers)


def test_status_shows_that_an_unfinished_run_is_paused(capsys: pytest.CaptureFixture[str]) -> None:
    for archived, is_shown in ((1, True), (3, False)):
        stdout.print(draw_progress(progress(archived).model_copy(update={"paused": True})))
        assert ("paused; continue with `factory jobs resume DIR`" in capsys.readouterr().out) is is_shown


def test_status_shows_the_remaining_time_until_the_run_is_finished(capsys: pytest.CaptureFixture[str]) -> None:
    for archived, left in ((1, "1 of 3 episodes archived, -, ETA 40 s"), (3, "3 of 3 episodes archived, -, finished")):
        stdout.print(draw_progress(progress(archived).model_copy(update={"eta_s": 40.0})))
        assert left in capsys.readouterr().out


def test_the_progress_bar_of_a_run_does_not_count_returned_jobs() -> None:
    bar = RunBar(load_plan("demo"))
    bar.show(progress(1).model_copy(update={"attempts": {"success": 1, "released": 2}}))
    assert bar.tasks[0].fields["note"].endswith("0 failed attempts")


def test_the_progress_bar_shows_nothing_before_the_progress_and_then_the_episodes_of_the_shard() -> None:
    text = StringIO()
    bar = RunBar(load_plan("demo"), console=Console(file=text, width=80))  # 24 episodes
    with bar:
        pass
    assert text.getvalue().strip() == ""
    bar.show(progress(1).model_copy(update={"planned": 8}))
    with bar:
        pass
    assert "1/8" in text.getvalue()


def test_status_and_progress_bar_count_built_layouts(capsys: pytest.CaptureFixture[str]) -> None:
    told = progress(1).model_copy(update={"layouts": {"archived": 3, "leased": 1, "pending": 4}})
    stdout.print(draw_progress(told))
    assert "3 of 8 layouts built" in capsys.readouterr().out
    bar = RunBar(load_plan("demo"))
    bar.show(told)
    assert bar.tasks[0].fields["note"].endswith("3 of 8 layouts built")


@pytest.mark.parametrize(("archived", "state"), [(1, "alive"), (3, "left")])
def test_a_finished_run_shows_no_workers(capsys: pytest.CaptureFixture[str], archived: int, state: str) -> None:
    beat = datetime(2026, 1, 1, tzinfo=UTC)
    worker = WorkerStatus(sid="host.1", host="host", slots=1, leased=0, archived=1, last_beat=beat, alive=True)
    stdout.print(draw_progress(progress(archived).model_copy(update={"workers": (worker,)})))
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "host.1" in line]
    assert line.split()[-1] == state


def test_a_watch_survives_a_restart_of_the_coordinator(capsys: pytest.CaptureFixture[str]) -> None:
    watch_progress(telling([1, None, None, 2, None, 3]), pause_s=0.001)
    assert "3 of 3 episodes archived" in capsys.readouterr().out


def test_a_watch_ends_with_an_error_after_a_long_silence() -> None:
    def always_silent() -> Iterable[int | None]:
        yield 1
        while True:
            yield None

    with pytest.raises(TransientError, match="no coordinator answers"):
        watch_progress(telling(always_silent()), pause_s=0.001, patience_s=0.05)


def test_a_coordinator_that_never_answered_is_reported_immediately() -> None:
    with pytest.raises(TransientError, match="no coordinator answers"):
        watch_progress(telling([None, 3]), pause_s=0.001)
