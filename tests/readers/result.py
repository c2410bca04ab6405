"""Prints the result of a reader as a row of the table that `formats.py` prints. Does not import this project."""

import sys
from importlib.metadata import version
from pathlib import Path


def print_row(export: Path, reader: str, read_back: str) -> None:
    """Prints one row: export, reader, and result."""
    sys.stdout.write(f"| `{export.name}` | {reader} | {read_back} |\n")
    sys.stdout.flush()


def named(*packages: str) -> str:
    """Returns package names with their installed versions."""
    return ", ".join(f"{package} {version(package)}" for package in packages)
