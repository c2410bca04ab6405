"""Tests find system tools with the PATH of an ordinary Debian user."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
USER_PATH = "/usr/local/bin:/usr/bin:/bin"
TOOLS = ("ip", "tc", "mount", "umount")
PROBE = "import shutil, tests.conftest; print(*(name for name in {names!r} if shutil.which(name)))"


@pytest.mark.parametrize("path", [USER_PATH, f"{USER_PATH}:/usr/sbin:/sbin"])
def test_tools_in_sbin_are_found_for_any_path_of_the_user(path: str) -> None:
    here = {name for name in TOOLS if shutil.which(name, path=f"{USER_PATH}:/usr/local/sbin:/usr/sbin:/sbin")}
    command = [sys.executable, "-c", PROBE.format(names=TOOLS)]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"PATH": path}, capture_output=True, text=True, check=True
    )
    assert set(done.stdout.split()) == here


def test_the_product_starts_only_the_python_interpreter_and_commands_of_slurm() -> None:
    started = re.compile(r"(?:subprocess\.\w+|Popen|os\.exec\w+|os\.system|os\.popen)\(\s*\[?\s*[\"'](\w+)")
    files = [
        path for package in ("schemas", "coordinator", "workers", "factory") for path in (ROOT / package).rglob("*.py")
    ]
    assert len(files) > 100
    found = {path.relative_to(ROOT).as_posix(): started.findall(path.read_text()) for path in files}
    assert {path: names for path, names in found.items() if names} == {"factory/submit/slurm.py": ["sbatch", "scancel"]}
