"""Tests the wheel in new environments of each supported Python: the base install and the extras.

Runs with `make test-install`; it installs packages, which takes minutes. The tests of one environment are a group:
one process runs them in the order of this file, because the last test installs a foreign package in the environment.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.support.extras import EXTRA_OF
from schemas.terms import Recording
from tests.builders.dataset import make_dataset
from tests.builders.driven import make_driven
from tests.builders.shared import build_once
from tests.install.interpreters import VERSIONS, Installed, build_wheel, find_python, install

READER, STATES_READER = (Path(__file__).with_name(name) for name in ("reader.py", "states_reader.py"))
SIMULATING = (
    ("run", "demo", "--out", "made"),
    ("worker",),
    ("coordinator", "start", "demo", "--out", "made"),
    ("gate", "--scene", "office"),
    ("jobs", "list", "dataset"),
    ("eval", "dataset", "--policy", "stop", "-o", "made"),
)
FOREIGN = "factory_boy==3.3.3"

pytestmark = pytest.mark.timeout(1200)


@pytest.fixture(scope="session")
def wheel(shared: Path) -> Path:
    (path,) = build_once(shared / "wheel", build_wheel).glob("*.whl")
    return path


@pytest.fixture(scope="session")
def base(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Installed]:
    """Returns a function that creates, at its first call, the environment of a Python version with the base install."""
    made: dict[str, Installed] = {}

    def environment(version: str) -> Installed:
        python = find_python(version)
        if python is None:
            pytest.skip(f"Python {version} is not installed")
        if version not in made:
            made[version] = install(python, version, tmp_path_factory.mktemp(f"base-{version}") / "venv", wheel)
        return made[version]

    return environment


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A directory with a dataset."""
    make_dataset(tmp_path / "dataset")
    return tmp_path


every_version = pytest.mark.parametrize(
    "version", [pytest.param(version, marks=pytest.mark.xdist_group(version)) for version in VERSIONS]
)
with_base_of_311 = pytest.mark.xdist_group("3.11")


@every_version
def test_the_base_install_can_read_export_and_display_a_dataset(
    base: Callable[[str], Installed], folder: Path, version: str
) -> None:
    environment = base(version)
    assert "read 3 episodes" in environment.run("python", READER, "dataset", cwd=folder).stdout
    environment.run("factory", "--help", cwd=folder)
    environment.run("factory", "stats", "dataset", cwd=folder)
    environment.run("factory", "verify", "dataset", cwd=folder)
    for name in ("sheet.png", "film.mp4"):
        environment.run("factory", "show", "dataset", "1", "-o", name, cwd=folder)
        assert (folder / name).stat().st_size > 1000
    for export in ("lerobot", "mcap", "webdataset", "paper"):
        environment.run("factory", "export", "dataset", "--to", export, "-o", f"out-{export}", cwd=folder)
    installed = environment.run("python", "-m", "pip", "list", "--format", "freeze", cwd=folder).stdout.lower()
    assert not [name for name in ("pybullet", "eclipse-zenoh", "embreex", "sqlalchemy") if name in installed]


@pytest.mark.gl
@every_version
def test_the_render_extra_reads_states_without_pybullet(
    wheel: Path, shared: Path, tmp_path: Path, version: str
) -> None:
    python = find_python(version)
    if python is None:
        pytest.skip(f"Python {version} is not installed")
    states = build_once(shared / "driven-states", lambda folder: make_driven(folder, Recording.STATES))
    environment = install(python, version, tmp_path / "venv", wheel, "[render]")
    said = environment.run("python", STATES_READER, states, cwd=tmp_path).stdout
    assert "without pybullet, zenoh, sqlalchemy, torch" in said
    environment.run("factory", "verify", states, "--render", "all", cwd=tmp_path)
    environment.run("factory", "bench", "read", states, "--frames", "4", "--workers", "0", cwd=tmp_path)
    tiny = environment.run(
        "factory", "verify", states, "--render", "1", cwd=tmp_path, expect=2, MINIVLA_RENDERER="tiny"
    )
    assert "the renderer tiny needs " in tiny.stderr
    no_egl = {"__EGL_VENDOR_LIBRARY_DIRS": "/nowhere"}
    bare = environment.run("factory", "verify", states, "--render", "1", cwd=tmp_path, expect=1, **no_egl)
    assert "apt-get install libegl1 libgl1-mesa-dri" in bare.stderr


@every_version
def test_simulating_commands_print_the_install_command(
    base: Callable[[str], Installed], wheel: Path, folder: Path, version: str
) -> None:
    for words in SIMULATING:
        said = base(version).run("factory", *words, cwd=folder, expect=2).stderr
        if "PyBullet" in said and version != "3.11":
            assert f"this is Python {version}" in said
        else:
            assert "-m pip install 'minivla-factory[sim] @ file://" in said, f"{words}: {said}"
            assert str(wheel) in said
    assert not (folder / "made").exists()


@with_base_of_311
@pytest.mark.parametrize("name", ["schemas", "workers", "coordinator", "factory"])
def test_a_foreign_package_on_the_path_is_named(base: Callable[[str], Installed], folder: Path, name: str) -> None:
    mine = folder / "project" / name
    mine.mkdir(parents=True)
    (mine / "__init__.py").touch()
    code = "from minivla import Dataset"
    project = str(mine.parent)
    said = base("3.11").run("python", "-c", code, cwd=folder, expect=1, PYTHONPATH=project).stderr
    assert f"needs its package '{name}'" in said
    assert str(mine) in said
    said = base("3.11").run("factory", "stats", "dataset", cwd=folder, expect=2, PYTHONPATH=project).stderr
    assert str(mine) in said
    assert "Traceback" not in said


def test_the_sim_extra_suffices_to_generate_data(wheel: Path, tmp_path: Path) -> None:
    python = find_python("3.11")
    if python is None:
        pytest.skip("Python 3.11 is not installed")
    environment = install(python, "3.11", tmp_path / "venv", wheel, "[sim]")
    made = "run", "demo", "--scene", "office", "--episodes", "1", "--workers", "1", "--out", "made"
    environment.run("factory", *made, cwd=tmp_path)
    assert ": valid (all bytes checked)" in environment.run("factory", "verify", "made", "--deep", cwd=tmp_path).stdout


def test_without_a_pybullet_wheel_the_error_names_the_supported_python(wheel: Path, tmp_path: Path) -> None:
    python = find_python("3.13")
    if python is None:
        pytest.skip("Python 3.13 is not installed")
    environment = install(python, "3.13", tmp_path / "venv", wheel, "[sim]")
    said = environment.run("factory", "run", "demo", "--out", "made", cwd=tmp_path, expect=2).stderr
    assert "`factory run` needs PyBullet" in said
    assert "python3.11 -m venv" in said
    assert not (tmp_path / "made").exists()


@with_base_of_311
def test_each_extra_that_a_message_names_is_declared(wheel: Path, base: Callable[[str], Installed]) -> None:
    code = "from importlib.metadata import metadata; print(*metadata('minivla-factory').get_all('Provides-Extra'))"
    declared = base("3.11").run("python", "-c", code, cwd=wheel.parent).stdout.split()
    assert set(EXTRA_OF.values()) <= set(declared)


@every_version
def test_public_package_works_after_factory_boy_replaced_the_factory_package(
    base: Callable[[str], Installed], folder: Path, version: str
) -> None:
    environment = base(version)
    environment.add(FOREIGN)
    foreign = "import factory; assert factory.Factory; assert not hasattr(factory, 'Dataset')"
    environment.run("python", "-c", foreign, cwd=folder)
    for first in ("", "import factory; "):
        code = f"{first}from minivla import Dataset; print(len(Dataset('dataset')))"
        assert environment.run("python", "-c", code, cwd=folder).stdout.strip() == "3"
    environment.run("factory", "stats", "dataset", cwd=folder)
