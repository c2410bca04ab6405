"""Summary of pip-audit's reports in `make audit`; a package without a result must not count as safe."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

AUDIT = Path(__file__).parents[1] / "install" / "audit.py"
FLAW = {"id": "PYSEC-1", "fix_versions": ["2.0"], "aliases": [], "description": ""}
SOUND = {"name": "a", "version": "1.0", "vulns": []}
FLAWED = {"name": "b", "version": "1.5", "vulns": [FLAW]}
UNKNOWN = {"name": "c", "skip_reason": "Dependency not found on PyPI and could not be audited: c (1.0)"}


@pytest.mark.parametrize(
    ("report", "options", "code", "said"),
    [
        (json.dumps({"dependencies": [SOUND]}), [], 0, "no known vulnerability in 1 locked packages; 0 are in no"),
        (json.dumps({"dependencies": [SOUND, FLAWED, UNKNOWN]}), [], 1, "b 1.5: PYSEC-1 (fixed in 2.0)"),
        (json.dumps({"dependencies": [SOUND, UNKNOWN]}), ["--strict"], 0, "1 are in no advisory database"),
        (json.dumps({"dependencies": [UNKNOWN]}), [], 0, "NOT AUDITED"),
        (json.dumps({"dependencies": [UNKNOWN]}), ["--strict"], 1, "NOT AUDITED"),
        ("Traceback: Failed to resolve", [], 0, "NOT AUDITED"),
        ("", ["--strict"], 1, "NOT AUDITED"),
    ],
)
def test_packages_that_could_not_be_audited_are_reported(
    tmp_path: Path, report: str, options: list[str], code: int, said: str
) -> None:
    (tmp_path / "report").write_text(report)
    tool = tmp_path / "pip-audit"
    tool.write_text(f"#!/bin/sh\ncat '{tmp_path / 'report'}'\n")
    tool.chmod(0o755)
    done = subprocess.run([sys.executable, str(AUDIT), str(tool), "x", *options], capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert said in done.stdout
