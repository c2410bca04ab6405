"""Finds interpreters, builds the wheel and installs it into virtual environments."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

VERSIONS = ("3.11", "3.12", "3.13")
ROOT = Path(__file__).parents[2]


class Installed:
    """A virtual environment with the wheel; `root` is its directory, `downloads` is the directory of pip's cache."""

    def __init__(self, root: Path, version: str, downloads: Path) -> None:
        self.root, self.version, self._downloads = root, version, downloads

    def run(self, *words: object, cwd: Path, expect: int = 0, **variables: str) -> subprocess.CompletedProcess[str]:
        """Runs a command of the environment with an empty HOME, outside of the checkout."""
        (cwd / "home").mkdir(exist_ok=True)
        kept = {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
        environment = {**kept, "HOME": str(cwd / "home"), "PATH": "/usr/local/bin:/usr/bin:/bin", **variables}
        command = [str(self.root / "bin" / str(words[0])), *map(str, words[1:])]
        done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == expect, f"{command}: exit {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done

    def add(self, *requirements: str) -> None:
        """Installs more packages."""
        pip = [self.root / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-compile"]
        environment = {"PIP_CACHE_DIR": str(self._downloads), **os.environ}
        subprocess.run([*map(str, pip), *requirements], env=environment, check=True)


def find_python(version: str) -> Path | None:
    """Returns an interpreter of a Python version from PATH or, if PATH has none, from pyenv; `None` if not found."""
    found = shutil.which(f"python{version}")
    homes = Path(os.environ.get("PYENV_ROOT", "/nonexistent"), "versions").glob(f"{version}.*/bin/python")
    for python in (*([found] if found else ()), *sorted(map(str, homes), reverse=True)):
        asked = [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        if done.returncode == 0 and done.stdout.strip() == version:
            return Path(python)
    return None


def build_wheel(folder: Path) -> Path:
    """Builds the wheel of this checkout and returns its path."""
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def install(python: Path, version: str, root: Path, wheel: Path, extras: str = "") -> Installed:
    """Creates a virtual environment and installs the wheel with its dependencies, without the checkout.

    Downloads are kept beside the wheel, for all environments of the session.
    """
    subprocess.run([str(python), "-m", "venv", str(root)], check=True)
    installed = Installed(root, version, wheel.parent / "downloads")
    installed.add(f"{wheel}{extras}")
    return installed
