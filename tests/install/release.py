"""`make release`: builds source distribution and wheel of the current commit, and tests them. Uploads nothing.

Usage: python -m tests.install.release DIST --twine TWINE [--tag TAG]. Only committed files are contained. Both files
are built twice, the wheel also from the source distribution, and the bytes must be equal: the times in the archives are
that of the commit (`SOURCE_DATE_EPOCH`). The wheel is installed into a new environment, where it reads a dataset.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import yaml

from tests.install.interpreters import ROOT, find_python, install

_HEADING = re.compile(r"^## (\S+) \((\S+)\)$", re.MULTILINE)
_PYTHON = "3.11"


def main() -> None:
    """Builds and tests the release; exits with a message if a check fails."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("dist", type=Path, help="Folder of the built files.")
    parser.add_argument("--twine", type=Path, required=True, help="The command twine.")
    parser.add_argument("--tag", default="", help="Tag of the commit, which must name the version.")
    words = parser.parse_args()
    if mistakes := find_disagreements(ROOT, words.tag):
        sys.exit("\n".join(f"error: {mistake}" for mistake in mistakes))
    with tempfile.TemporaryDirectory(prefix="release-") as folder:
        sdist, wheel = build_release(ROOT, Path(folder))
        subprocess.run([str(words.twine), "check", "--strict", str(sdist), str(wheel)], check=True)
        _collect_tests(unpack(sdist, Path(folder) / "tested"))
        _use(wheel, Path(folder) / "used", version_of(ROOT))
        words.dist.mkdir(exist_ok=True)
        for former in words.dist.glob("minivla_factory-*"):
            former.unlink()
        for built in (sdist, wheel):
            _say(f"{shutil.copy(built, words.dist)}: {built.stat().st_size / 1e6:.1f} MB")


def version_of(root: Path) -> str:
    return str(tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"])


def find_disagreements(root: Path, tag: str = "") -> list[str]:
    """Returns the places whose version or date differ from `pyproject.toml` and `CHANGELOG.md`."""
    version = version_of(root)
    citation = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    heading = _HEADING.search((root / "CHANGELOG.md").read_text(encoding="utf-8"))
    newest, date = heading.groups() if heading else ("none", "none")
    return [
        f"{what} is {found!r}, expected {expected!r}"
        for what, found, expected in (
            ("the newest version of CHANGELOG.md", newest, version),
            ("the version of CITATION.cff", citation["version"], version),
            ("the date of CITATION.cff", citation["date-released"], date),
            ("the tag", tag or f"v{version}", f"v{version}"),
        )
        if found != expected
    ]


def build_release(root: Path, folder: Path) -> tuple[Path, Path]:
    """Builds the commit of a checkout and returns the paths of source distribution and wheel.

    Args:
        root: checkout.
        folder: empty folder.

    Raises:
        SystemExit: the checkout has uncommitted changes, or two builds differ.
    """
    if changed := _git(root, "status", "--porcelain", "--untracked-files=no"):
        sys.exit(f"error: commit or discard these changes first, because they would not be released:\n{changed}")
    epoch = _git(root, "log", "-1", "--format=%ct")
    once, again = (_export(root, folder / name, mask) for name, mask in (("once", 0o022), ("again", 0o077)))
    sdist, wheel = (_build(once, kind, folder / "dist", epoch) for kind in ("sdist", "wheel"))
    _require_same(sdist, _build(again, "sdist", folder / "again-dist", epoch))
    unpacked = unpack(sdist, folder / "unpacked")
    _require_same(wheel, _build(unpacked, "wheel", folder / "unpacked-dist", epoch))
    return sdist, wheel


def unpack(sdist: Path, folder: Path) -> Path:
    """Unpacks a source distribution and returns the folder of its files."""
    folder.mkdir()
    # tar, because the argument `filter` of extractall came with Python 3.11.4, and Debian's is 3.11.2
    subprocess.run(["tar", "-xf", str(sdist.resolve()), "-C", str(folder)], check=True)
    (inner,) = folder.iterdir()
    return inner


def _export(root: Path, folder: Path, mask: int) -> Path:
    """Writes the files of the commit to a folder, with the permissions that a umask leaves."""
    folder.mkdir()
    packed = subprocess.run(["git", "archive", "HEAD"], cwd=root, check=True, capture_output=True).stdout
    unpacking = ["tar", "-x", "--no-same-permissions", "-C", str(folder)]
    subprocess.run(unpacking, input=packed, umask=mask, check=True)
    return folder


def _build(source: Path, kind: str, folder: Path, epoch: str) -> Path:
    build = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    environment = {**os.environ, "SOURCE_DATE_EPOCH": epoch}
    subprocess.run(build, cwd=source, env=environment, check=True, stdout=subprocess.DEVNULL)
    (path,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return path


def _require_same(first: Path, second: Path) -> None:
    if first.read_bytes() != second.read_bytes():
        sys.exit(f"error: two builds of {first.name} differ")


def _collect_tests(source: Path) -> None:
    """Collects the test suite in an unpacked source distribution, and runs the tests of the documents."""
    pytest = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    subprocess.run([*pytest, "--collect-only"], cwd=source, check=True, stdout=subprocess.DEVNULL)
    subprocess.run([*pytest, "tests/test_documents.py"], cwd=source, check=True)


def _use(wheel: Path, folder: Path, version: str) -> None:
    """Installs the wheel into a new environment and reads a dataset there."""
    from tests.builders.dataset import make_dataset

    folder.mkdir()
    python = find_python(_PYTHON)
    if python is None:
        sys.exit(f"error: Python {_PYTHON} is not on PATH")
    make_dataset(folder / "dataset")
    _say("installing the wheel into a new environment")
    environment = install(python, _PYTHON, folder / "venv", wheel)
    said = environment.run("factory", "--version", cwd=folder).stdout
    if version not in [word.partition("+")[0] for word in said.split()]:
        sys.exit(f"error: the installed command has version {said.strip()!r}, expected {version}")
    imported = "import minivla, sys; sys.exit(minivla.__version__ != sys.argv[1])"
    environment.run("python", "-c", imported, version, cwd=folder)
    read = environment.run("python", ROOT / "tests" / "install" / "reader.py", "dataset", cwd=folder)
    _say(read.stdout.strip())
    for verb in ("stats", "verify"):
        environment.run("factory", verb, "dataset", cwd=folder)


def _git(root: Path, *words: str) -> str:
    return subprocess.run(["git", *words], cwd=root, check=True, capture_output=True, text=True).stdout.strip()


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
