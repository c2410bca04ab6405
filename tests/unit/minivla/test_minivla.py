"""The public package: light, complete, and robust against foreign packages with the same names."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import minivla
from factory.dataset.reader import Dataset
from factory.dataset.torch import FrameDataset
from minivla.packages import NAMES, require_own_packages

ROOT = Path(__file__).parents[3]
FACTORY_BOY = {
    "alchemy",
    "base",
    "builder",
    "declarations",
    "django",
    "enums",
    "errors",
    "faker",
    "fuzzy",
    "helpers",
    "mogo",
    "mongoengine",
    "random",
    "utils",
}
"""Modules that factory_boy 3.3 installs into the folder `factory`, which this project also uses."""


def python(code: str, path: Path | None = None, expect: int = 0) -> subprocess.CompletedProcess[str]:
    found = os.pathsep.join(map(str, filter(None, (path, ROOT))))
    variables = {**os.environ, "PYTHONPATH": found}
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == expect, done.stderr
    return done


def test_public_names_are_those_of_the_product() -> None:
    assert minivla.Dataset is Dataset
    assert minivla.FrameDataset is FrameDataset
    assert set(minivla.__all__) <= set(dir(minivla))
    assert minivla.__version__
    with pytest.raises(AttributeError, match="no attribute 'Datasets'"):
        _ = minivla.Datasets  # type: ignore[attr-defined]


def test_importing_the_public_package_loads_nothing_of_the_product() -> None:
    said = python("import sys, minivla; print([n for n in sys.modules if n.split('.')[0] in minivla.packages.NAMES])")
    assert said.stdout.strip() == "[]"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("form", ["package", "module"])
def test_a_foreign_package_that_comes_first_on_the_import_path_is_named(tmp_path: Path, name: str, form: str) -> None:
    foreign = tmp_path / name if form == "package" else tmp_path / f"{name}.py"
    if form == "package":
        foreign.mkdir()
    (foreign / "__init__.py" if form == "package" else foreign).write_text("")
    said = python("from minivla import Dataset", tmp_path, expect=1).stderr
    assert f"ImportError: minivla-factory needs its package '{name}' in {ROOT}, but Python imports {foreign}" in said
    done = python("from minivla.command import main; main()", tmp_path, expect=2)
    assert done.stderr.startswith(f"error: minivla-factory needs its package '{name}'")


def test_a_foreign_package_that_was_imported_before_is_named(tmp_path: Path) -> None:
    (tmp_path / "schemas").mkdir()
    (tmp_path / "schemas" / "__init__.py").touch()
    before = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import schemas; sys.path.pop(0)"
    code = f"{before}; from minivla import Dataset"
    assert f"but Python imports {tmp_path / 'schemas'}" in python(code, expect=1).stderr


def test_a_data_folder_named_like_the_package_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "workers").mkdir()
    (tmp_path / "workers" / "ann.txt").touch()
    python("from minivla import Dataset", tmp_path)


def test_an_incomplete_installation_is_named(tmp_path: Path) -> None:
    with pytest.raises(ImportError, match=f"needs its package 'schemas' in {tmp_path}"):
        require_own_packages(tmp_path)


def test_public_package_works_where_factory_init_was_overwritten(tmp_path: Path) -> None:
    for name in (*NAMES, "minivla"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "factory" / "__init__.py").write_text("class Factory: ...\n")
    code = "import factory; from minivla import Dataset, FrameDataset; print(factory.Factory, Dataset)"
    variables = {**os.environ, "PYTHONPATH": str(tmp_path)}
    script = [sys.executable, "-P", "-S", "-c", f"import sys; sys.path += {sys.path!r}; {code}"]
    done = subprocess.run(script, env=variables, capture_output=True, text=True, check=False)
    assert "factory.dataset.reader.Dataset" in done.stdout, done.stderr


def test_factory_boy_overwrites_no_module_of_the_product() -> None:
    ours = {path.stem for path in (ROOT / "factory").iterdir() if path.name != "__init__.py"}
    assert not ours & FACTORY_BOY


def test_environment_is_found_through_the_public_package() -> None:
    pytest.importorskip("gymnasium")
    code = """
import gymnasium
for id in ("minivla:MiniVLANav-v0", "minivla.gym:MiniVLANav-v0", "factory.gym:MiniVLANav-v0"):
    try:
        gymnasium.make(id, data="nowhere")
    except Exception as error:
        print(type(error).__name__)
"""
    assert python(code).stdout.split() == ["WorldError"] * 3
    assert (
        "minivla.gym"
        in python("import minivla.gym, gymnasium; gymnasium.spec('MiniVLANav-v0'); print(minivla.gym)").stdout
    )
