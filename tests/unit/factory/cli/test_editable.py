"""Documented commands that add an extra keep the editable installation of a checkout. Needs no network."""

from __future__ import annotations

import re
import shutil
import subprocess
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[4]
DOCUMENTS = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "deploy/README.md")]
_INSTALL = re.compile(r"pip install[^`\n]*\n?[^`\n]*?(?<=[ \n'\"])\.(?:\[[a-z,-]+\])?(?=['\"`\s])")


def test_every_documented_command_for_a_checkout_is_editable() -> None:
    found = [
        (path.name, command)
        for path in (*DOCUMENTS, *(ROOT / "docs").rglob("*.md"))
        for command in _INSTALL.findall(path.read_text())
    ]
    assert len(found) >= 8
    assert [(name, command) for name, command in found if "-e" not in command.split()] == []


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A copy of this checkout with its own environment, which also finds the packages of this one."""
    copy = tmp_path / "checkout"
    copy.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE", "Makefile", "requirements.txt"):
        shutil.copy(ROOT / name, copy / name)
    for name in ("minivla", "factory", "workers", "coordinator", "schemas"):
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    venv.create(copy / ".venv", symlinks=True)
    site = next((copy / ".venv" / "lib").glob("python*")) / "site-packages"
    # only the folder: a .pth file in it, such as that of the editable installation of this checkout, is not read
    (site / "packages.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (copy / ".venv" / ".ready").touch()
    return copy


def run(copy: Path, *command: str) -> str:
    done = subprocess.run(command, cwd=copy, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_an_edit_has_effect_after_an_extra_was_added(checkout: Path, tmp_path: Path) -> None:
    python = str(checkout / ".venv" / "bin" / "python")
    offline = "--no-deps --no-build-isolation --no-index"
    run(checkout, "sh", "-c", f"{python} -m pip install --quiet {offline} -e .")
    printed = run(checkout, "make", "--dry-run", "setup", "EXTRAS=train").splitlines()
    (of_make,) = (line for line in printed if "pip install" in line)
    for number, command in enumerate((of_make, f"{python} -m pip install -e '.[train]'")):
        run(checkout, "sh", "-c", f"{command} {offline}")
        with (checkout / "minivla" / "packages.py").open("a") as file:
            file.write(f"\nEDITED = {number}\n")
        said = run(tmp_path, python, "-c", "import minivla.packages as it; print(it.__file__, it.EDITED)")
        assert said.split() == [str(checkout / "minivla" / "packages.py"), str(number)]
