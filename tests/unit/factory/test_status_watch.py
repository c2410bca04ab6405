"""Watching a run: a coordinator that is away for a moment is asked again, one that stays away ends the watch."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest

from factory.cli.status import watch_progress
from schemas.errors import TransientError
from schemas.wire import Progress


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
    """Returns a source that gives each answer in turn; `None` is silence."""
    left = iter(answers)

    def source() -> Progress:
        answer = next(left)
        if answer is None:
            raise TransientError("nobody answers")
        return progress(answer)

    return source


def test_a_watch_outlives_a_restart(capsys: pytest.CaptureFixture[str]) -> None:
    watch_progress(telling([1, None, None, 2, None, 3]), pause_s=0.001)
    assert "3 of 3 episodes archived" in capsys.readouterr().out


def test_a_watch_ends_with_the_error_when_the_silence_lasts() -> None:
    def always_silent() -> Iterable[int | None]:
        yield 1
        while True:
            yield None

    with pytest.raises(TransientError, match="nobody answers"):
        watch_progress(telling(always_silent()), pause_s=0.001, patience_s=0.05)


def test_who_never_answered_is_not_waited_for() -> None:
    with pytest.raises(TransientError, match="nobody answers"):
        watch_progress(telling([None, 3]), pause_s=0.001)
