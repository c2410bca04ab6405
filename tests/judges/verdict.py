"""How a judge says what it found: a row of the table that `formats.py` prints. Imports nothing of ours."""

import sys
from importlib.metadata import version
from pathlib import Path


def say(export: Path, reader: str, read_back: str) -> None:
    """Prints one row: which export, opened with what, what was read back."""
    sys.stdout.write(f"| `{export.name}` | {reader} | {read_back} |\n")
    sys.stdout.flush()


def named(*packages: str) -> str:
    """Returns packages with the versions they have here."""
    return ", ".join(f"{package} {version(package)}" for package in packages)
