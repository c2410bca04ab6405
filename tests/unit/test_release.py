"""`make release`: versions and dates agree, two builds have the same bytes, and only committed files are released."""

from __future__ import annotations

import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.install.release import ROOT, build_release, find_disagreements, unpack, version_of

PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "small"
version = "1.2.3"
[tool.hatch.build.targets.wheel]
packages = ["small"]
"""
FILES = {
    "pyproject.toml": PROJECT,
    ".gitignore": "/build/\n",
    "small/__init__.py": "",
    "small/data.toml": "x = 1\n",
    "tests/test_small.py": "import small\n",
}
STATED = ("pyproject.toml", "CITATION.cff", "CHANGELOG.md")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout of a small project, with an ignored folder and an untracked file."""
    root = tmp_path / "checkout"
    for name, text in {**FILES, "build/large.bin": "x", "small/notes.txt": "not committed"}.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    git(root, "init", "--quiet")
    git(root, "add", *FILES)
    git(root, "-c", "user.name=a", "-c", "user.email=a@b", "commit", "--quiet", "-m", "Begin")
    (tmp_path / "built").mkdir()
    return root


def git(root: Path, *words: str) -> None:
    subprocess.run(["git", *words], cwd=root, check=True)


def test_versions_and_dates_of_the_project_agree() -> None:
    assert find_disagreements(ROOT, f"v{version_of(ROOT)}") == []


def test_every_disagreement_is_reported(tmp_path: Path) -> None:
    for name in STATED:
        shutil.copy(ROOT / name, tmp_path)
    version = version_of(ROOT)
    assert find_disagreements(tmp_path) == []
    assert find_disagreements(tmp_path, "v0.0.1") == [f"the tag is 'v0.0.1', expected 'v{version}'"]
    text = (tmp_path / "pyproject.toml").read_text()
    (tmp_path / "pyproject.toml").write_text(text.replace(f'version = "{version}"', 'version = "99.0"', 1))
    assert len(find_disagreements(tmp_path, f"v{version}")) == 3
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n")
    assert "the newest version of CHANGELOG.md is 'none', expected '99.0'" in find_disagreements(tmp_path)


def test_two_builds_of_a_commit_have_the_same_bytes_and_contain_the_committed_files(
    checkout: Path, tmp_path: Path
) -> None:
    sdist, wheel = build_release(checkout, tmp_path / "built")
    files = unpack(sdist, tmp_path / "files")
    assert {str(path.relative_to(files)) for path in files.rglob("*") if path.is_file()} == {*FILES, "PKG-INFO"}
    with zipfile.ZipFile(wheel) as archive:
        assert {name for name in archive.namelist() if "dist-info" not in name} == {
            "small/__init__.py",
            "small/data.toml",
        }
    (checkout / "small" / "notes.txt").unlink()
    (checkout / "small" / "data.toml").touch()
    (tmp_path / "later").mkdir()
    again = build_release(checkout, tmp_path / "later")
    assert [path.read_bytes() for path in again] == [sdist.read_bytes(), wheel.read_bytes()]
    with tarfile.open(sdist) as archive:
        assert {member.mode & 0o777 for member in archive if member.isfile()} == {0o644}


def test_uncommitted_changes_are_refused(checkout: Path, tmp_path: Path) -> None:
    (checkout / "small" / "data.toml").write_text("x = 2\n")
    with pytest.raises(SystemExit, match=r"would not be released:\n.*small/data\.toml"):
        build_release(checkout, tmp_path / "built")


def test_a_build_that_depends_on_its_folder_is_refused(checkout: Path, tmp_path: Path) -> None:
    hook = """
from pathlib import Path
from hatchling.metadata.plugin.interface import MetadataHookInterface
class Hook(MetadataHookInterface):
    def update(self, metadata): metadata["description"] = str(Path(self.root))
"""
    dynamic = PROJECT.replace('version = "1.2.3"', 'version = "1.2.3"\ndynamic = ["description"]')
    (checkout / "hatch_build.py").write_text(hook)
    (checkout / "pyproject.toml").write_text(f"{dynamic}[tool.hatch.metadata.hooks.custom]\n")
    git(checkout, "add", "hatch_build.py", "pyproject.toml")
    git(checkout, "-c", "user.name=a", "-c", "user.email=a@b", "commit", "--quiet", "-m", "Name the folder")
    with pytest.raises(SystemExit, match=r"two builds of small-1\.2\.3\.tar\.gz differ"):
        build_release(checkout, tmp_path / "built")
