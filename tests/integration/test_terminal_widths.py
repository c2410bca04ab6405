"""Output of commands on a real terminal of 60, 80 and 120 columns: no line is wider, and no name is broken."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import sys
import termios
from pathlib import Path

import pytest

from tests.builders.archived import ArchivedRun
from tests.builders.dataset import make_dataset

WORDS = ("cancelled", "archived", "warehouse_multiple_shelves", "test_paraphrase_ood")
"""Names that a narrow terminal must not break."""


def on_terminal(columns: int, *words: str) -> str:
    """Returns the output of `factory` on a terminal of that width, without colours."""
    child, terminal = pty.fork()
    if child == 0:
        fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
        environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"} | {"TERM": "xterm"}
        os.execve(sys.executable, [sys.executable, "-m", "factory", *words], environment)
    told = b""
    try:
        while data := os.read(terminal, 1 << 16):
            told += data
    except OSError:  # Linux reports the closed other end this way
        pass
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, told
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", told.decode()).replace("\r\n", "\n")


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("terminal")
    run = ArchivedRun(folder / "run", planned=5, done=3, misses=2)
    run.desk.engine.dispose()
    make_dataset(folder / "data", 2)
    return {"RUN": str(Path(run.root)), "DATA": str(folder / "data")}


@pytest.mark.parametrize("columns", [60, 80, 120])
@pytest.mark.parametrize(
    "words",
    [
        ("status", "RUN"),
        ("jobs", "list", "RUN"),
        ("jobs", "show", "RUN", "1"),
        ("stats", "DATA"),
        ("plan", "show", "demo"),
        ("scene", "list"),
    ],
)
def test_tables_fit_the_terminal(places: dict[str, str], words: tuple[str, ...], columns: int) -> None:
    text = on_terminal(columns, *(places.get(word, word) for word in words))
    lines = [part.rstrip() for line in text.split("\n") for part in line.split("\r")]
    assert len(lines) > 3
    assert [line for line in lines if len(line) > columns and "/" not in line] == []
    whole = text.replace("\n", "")
    for word in WORDS:
        assert whole.count(word) == text.count(word)
