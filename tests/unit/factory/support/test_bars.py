"""Progress of active work: occasional log lines without a terminal, and a bar without log lines on a terminal."""

from __future__ import annotations

import re
from io import StringIO

import pytest
from rich.console import Console
from rich.progress import MofNCompleteColumn

from factory.support.terminal import Bars

COLUMNS = (MofNCompleteColumn(),)


def lines_of(text: StringIO) -> list[str]:
    return [line.rstrip() for line in text.getvalue().splitlines() if line.strip()]


def test_a_log_file_gets_progress_lines() -> None:
    text = StringIO()
    with Bars(*COLUMNS, console=Console(file=text), transient=True, pause_s=0.0) as bar:
        task = bar.add_task("paper", total=240, note="")
        bar.update(task, completed=94, note="1052 episodes/h")
        bar.advance(task)
    times, lines = zip(*(line.split(" UTC ", 1) for line in lines_of(text)), strict=True)
    assert lines == ("paper  94/240 1052 episodes/h", "paper  95/240 1052 episodes/h")
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d", time) for time in times)


def test_progress_lines_are_rare() -> None:
    text = StringIO()
    with Bars(*COLUMNS, console=Console(file=text), transient=True, pause_s=3600.0) as bar:
        task = bar.add_task("paper", total=240, note="")
        for done in range(100):
            bar.update(task, completed=done)
        assert lines_of(text) == []


def test_finished_or_unbounded_work_prints_no_progress_line() -> None:
    text = StringIO()
    with Bars(*COLUMNS, console=Console(file=text), transient=True, pause_s=0.0) as bar:
        bar.update(bar.add_task("episodes", total=2, note=""), completed=2)
        bar.update(bar.add_task("figures", total=None, note=""), completed=1)
        assert lines_of(text) == []


def test_a_terminal_shows_a_bar_and_no_lines() -> None:
    seen, told = StringIO(), StringIO()
    for text, pause_s in ((seen, 0.0), (told, 3600.0)):
        console = Console(file=text, force_terminal=True, width=80)
        with Bars(*COLUMNS, console=console, refresh_per_second=0.01, pause_s=pause_s) as bar:
            bar.update(bar.add_task("paper", total=240, note=""), completed=94)
    assert seen.getvalue() == told.getvalue()


LONG_NOTE = "1052 episodes/h, 14 min 10 s left, 2 running, 13 failed attempts"


@pytest.mark.parametrize("width", [60, 80, 120])
def test_a_narrow_terminal_shows_counts_times_and_notes_in_full(width: int) -> None:
    text = StringIO()
    console = Console(file=text, force_terminal=True, width=width, color_system=None)
    with Bars(console=console, refresh_per_second=0.01) as bar:
        bar.update(bar.add_task("my_package.my_module:MyLongPolicyClass", total=60), completed=40, note="12 succeeded")
        bar.update(bar.add_task("paper", total=1174), completed=940, note=LONG_NOTE)
    told = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.getvalue())
    assert max(len(line) for line in re.split(r"[\r\n]", told)) <= width
    assert "940/1174 0:00:0" in told
    assert "…" not in told
    assert LONG_NOTE in " ".join(told.split())
