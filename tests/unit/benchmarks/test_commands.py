"""The benchmarks that were subcommands of `factory bench` are programs with the same options."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import click
import pytest

from factory.cli.bench import MOVED

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", MOVED)
def test_a_moved_benchmark_is_a_command_with_a_json_option(name: str) -> None:
    command = importlib.import_module(f"tests.benchmarks.{name}").command
    assert isinstance(command, click.Command)
    assert command.get_help(click.Context(command)).startswith("Usage:")
    assert "--json" in {option for parameter in command.params for option in parameter.opts}


@pytest.mark.parametrize(("words", "code"), [(("--help",), 0), (("--nothing",), 2), (("nowhere",), 1)])
def test_a_benchmark_exits_with_the_codes_of_the_command_line(words: tuple[str, ...], code: int) -> None:
    command = [sys.executable, "-m", "tests.benchmarks.serve", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
