"""Fixtures of the whole suite: no test may touch the user's home or caches."""

from __future__ import annotations

import atexit
import gc
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import hypothesis
import pytest

from tests.acceptance.factory_cli import Command, FactoryCli
from tests.builders.layouts import Layouts
from tests.builders.object_server import ENVIRONMENT, ObjectServer, object_server
from tests.builders.postgres import Postgres, postgres, why_no_postgres
from tests.builders.process_state import unchanged_process
from tests.builders.shared import session_folder
from tests.builders.tools import find_system_tools

find_system_tools()  # before test modules look for tools
atexit.register(gc.freeze)  # garbage collections at the exit of the interpreter would take seconds
# tests must not depend on the speed of the machine
hypothesis.settings.register_profile(
    "any-speed", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("any-speed")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the number of tested seeds of each built-in scene, and an option for each folder that is off by default."""
    parser.addoption("--scene-seeds", type=int, default=1, help="seeds of each built-in scene to test")
    parser.addoption("--install", action="store_true", help="run tests/install, which installs the wheel from an index")
    parser.addoption("--engines", action="store_true", help="run tests/engines, which needs Slurm and Ray")
    parser.addoption("--ray", action="store_true", help="run tests/ray, which starts a Ray cluster on loopback")
    parser.addoption("--slurm", action="store_true", help="run tests/slurm, which starts a Slurm on loopback")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Ignores the optional test folders unless the option with the name of the folder is given."""
    folders = ("engines", "install", "ray", "slurm")
    option = next((name for name in folders if collection_path == Path(__file__).parent / name), None)
    return True if option is not None and not config.getoption(f"--{option}") else None


def pytest_collection() -> None:
    """Disables the garbage collector during test collection, which creates millions of objects that are kept."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Enables the garbage collector with fewer collections, which skip the objects that test collection has created."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)
    gc.enable()


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder shared by all processes of the session, for data built by `build_once`."""
    return session_folder(tmp_path_factory.getbasetemp())


@pytest.fixture(scope="session")
def cache(shared: Path) -> Path:
    """Cache (`MINIVLA_CACHE`) shared by the tests of one session: each built-in scene is compiled once."""
    return shared / "cache"


@pytest.fixture(scope="session")
def layouts(shared: Path) -> Layouts:
    """Layouts of the built-in families, each laid out once; tests only read them."""
    folder = shared / "layouts"
    folder.mkdir(exist_ok=True)
    return Layouts(folder)


@pytest.fixture(scope="session")
def factory(tmp_path_factory: pytest.TempPathFactory, cache: Path) -> Iterator[FactoryCli]:
    """The command line as processes, with an empty home and the shared cache."""
    cli = FactoryCli(tmp_path_factory.mktemp("empty-home"), cache)
    yield cli
    cli.end()


@pytest.fixture(scope="session")
def command(cache: Path) -> Command:
    """The command line in the process of the test, with the shared cache; other variables are those of the test."""
    return Command(cache)


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[Postgres]:
    """A PostgreSQL server shared by the tests of one session; skips with the reason if none is available."""
    reason = why_no_postgres()
    if reason:
        pytest.skip(reason)
    with postgres() as server:
        yield server


@pytest.fixture(scope="session")
def object_store() -> Iterator[ObjectServer]:
    """An S3 server on loopback shared by the tests of one session."""
    with object_server() as server:
        yield server


@pytest.fixture
def bucket_url(object_store: ObjectServer, monkeypatch: pytest.MonkeyPatch) -> Callable[[], str]:
    """Creates new buckets for this process and its children and returns their URLs."""
    for name, value in object_store.variables().items():
        monkeypatch.setenv(name, value)
    return lambda: f"s3://{object_store.new_bucket()}"


@pytest.fixture(autouse=True)
def guarded_process() -> Iterator[None]:
    """Restores the shared state of the test process and fails a test that changed it."""
    with unchanged_process():
        yield


@pytest.fixture(scope="session")
def homes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Yields a new home path for each test; `mktemp` would list all existing folders for each new one."""
    folder = tmp_path_factory.mktemp("homes")
    return (folder / str(number) for number in itertools.count(1))


@pytest.fixture(autouse=True)
def guarded_home(guarded_process: None, monkeypatch: pytest.MonkeyPatch, homes: Iterator[Path], shared: Path) -> None:
    """Sets HOME and every cache to a private folder of the test; compiled shaders of Mesa are shared by all tests."""
    home = next(homes)
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("MINIVLA_CACHE", str(home / "cache"))
    monkeypatch.setenv("MINIVLA_STATE", str(home / "state"))
    monkeypatch.setenv("MESA_SHADER_CACHE_DIR", str(shared / "shaders"))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    for name in ENVIRONMENT:
        monkeypatch.delenv(name, raising=False)
