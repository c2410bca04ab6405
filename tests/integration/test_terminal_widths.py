"""Output of commands on a pseudo-terminal of 60, 80 and 120 columns: no line is wider, and no name is broken."""

from __future__ import annotations

import json
import os
import pty
import re
import sys
from pathlib import Path

import pytest

from tests.builders.archived import ArchivedRun
from tests.builders.dataset import make_dataset

WORDS = ("cancelled", "archived", "warehouse_multiple_shelves", "test_paraphrase_ood")
"""Names that a narrow terminal must not break."""


COMMANDS = (
    ("status", "RUN"),
    ("jobs", "list", "RUN"),
    ("jobs", "show", "RUN", "1"),
    ("stats", "DATA"),
    ("plan", "show", "demo"),
    ("scene", "list"),
)
WIDTHS = (60, 80, 120)
_END = "END OF COMMAND"
_PROGRAM = f"""
import fcntl, json, struct, sys, termios
from factory.cli.main import cli
for columns, words in json.loads(sys.argv[1]):
    fcntl.ioctl(1, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
    status = cli.main(words, standalone_mode=False)
    print("{_END}", status or 0, flush=True)
"""


def on_terminal(calls: list[tuple[int, list[str]]]) -> list[str]:
    """Runs `factory` for each (columns, arguments) on a terminal of that width; returns the outputs without colours."""
    child, terminal = pty.fork()
    if child == 0:
        environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"} | {"TERM": "xterm"}
        os.execve(sys.executable, [sys.executable, "-c", _PROGRAM, json.dumps(calls)], environment)
    told = b""
    try:
        while data := os.read(terminal, 1 << 16):
            told += data
    except OSError:  # on Linux, the other end was closed
        pass
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0, told
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", told.decode()).replace("\r\n", "\n")
    *outputs, rest = text.split(f"{_END} 0\n")
    assert rest == ""
    return outputs


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("terminal")
    run = ArchivedRun(folder / "run", planned=5, done=3, misses=2)
    run.timed_ledger.engine.dispose()
    make_dataset(folder / "data", 2)
    return {"RUN": str(Path(run.root)), "DATA": str(folder / "data")}


@pytest.fixture(scope="module")
def texts(places: dict[str, str]) -> dict[tuple[tuple[str, ...], int], str]:
    """Outputs by command and width; one process runs all commands, because its imports take most of the time."""
    asked = [(words, columns) for words in COMMANDS for columns in WIDTHS]
    calls = [(columns, [places.get(word, word) for word in words]) for words, columns in asked]
    return dict(zip(asked, on_terminal(calls), strict=True))


@pytest.mark.parametrize("columns", WIDTHS)
@pytest.mark.parametrize("words", COMMANDS)
def test_tables_fit_the_terminal(
    texts: dict[tuple[tuple[str, ...], int], str], words: tuple[str, ...], columns: int
) -> None:
    text = texts[words, columns]
    lines = [part.rstrip() for line in text.split("\n") for part in line.split("\r")]
    assert len(lines) > 3
    assert [line for line in lines if len(line) > columns and "/" not in line] == []
    whole = text.replace("\n", "")
    for word in WORDS:
        assert whole.count(word) == text.count(word)
