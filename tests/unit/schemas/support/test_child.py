"""The environment of child processes; every process is started with it."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.support.child import child_environment, import_path, python_module

ROOT = Path(__file__).parents[4]
SOURCES = [
    path for package in ("schemas", "coordinator", "workers", "factory") for path in (ROOT / package).rglob("*.py")
]


def nodes_of_files_with(word: str) -> Iterator[tuple[Path, ast.AST]]:
    """Yields the syntax nodes of the source files that contain a word; other files are not parsed."""
    for path in SOURCES:
        source = path.read_text()
        if word in source:
            yield from ((path, node) for node in ast.walk(ast.parse(source)))


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_package_paths_are_inherited_and_the_working_directory_is_not(elsewhere: Path) -> None:
    given = {"PATH": "/bin", "VIRTUAL_ENV": "/venv", "PYTHONHOME": "/opt/python", "PYTHONPATH": ":/cluster:.:/site:"}
    assert child_environment(given) == {**given, "PYTHONPATH": "/cluster:/site"}


@pytest.mark.parametrize("name", ["PYTHONSTARTUP", "PYTHONINSPECT", "PYTHONBREAKPOINT"])
def test_variables_of_an_interactive_session_are_not_inherited(elsewhere: Path, name: str) -> None:
    assert child_environment({name: "x", "PYTHONPATH": "."}) == {}


def test_the_import_path_is_inherited_without_the_working_directory(elsewhere: Path) -> None:
    assert import_path(["", str(elsewhere), "/site", "."]) == "/site"


def test_a_checkout_that_is_not_installed_still_finds_its_own_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    assert child_environment({}) == {"PYTHONPATH": str(ROOT)}
    assert str(ROOT) in import_path([str(ROOT)]).split(os.pathsep)


def test_a_child_imports_no_file_of_the_working_directory(elsewhere: Path) -> None:
    for name in ("json", "isal", "click"):
        (elsewhere / f"{name}.py").write_text("raise SystemExit(7)")
    done = subprocess.run(python_module("json.tool"), env=child_environment(os.environ), input=b"1", timeout=60)
    assert done.returncode == 0


def test_processes_that_write_no_log_do_not_import_the_logging_library() -> None:
    children = "workers.sim.simulate", "workers.render.process_child", "coordinator.validation.validator_child"
    code = f"import sys, {', '.join(children)}, factory.verify.episode; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {*children, "factory.verify.episode"} <= loaded
    assert {"structlog", "rich", "asyncio", "click"} & loaded == set()


def test_python_is_started_by_one_function_only() -> None:
    strays = {
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, node in nodes_of_files_with("executable")
        if path != ROOT / "schemas/support/child.py"
        and isinstance(node, ast.Attribute)
        and ast.unparse(node) == "sys.executable"
    }
    assert {stray.partition(":")[0] for stray in strays} <= {
        "factory/cli/main.py",  # starts itself again with the same arguments
        "schemas/support/extras.py",  # names the interpreter in a message
    }


def test_every_process_is_started_with_an_explicit_environment() -> None:
    calls = [
        (path, node)
        for path, node in nodes_of_files_with("subprocess")
        if isinstance(node, ast.Call) and ast.unparse(node.func) in {"subprocess.Popen", "subprocess.run"}
    ]
    assert calls
    bare = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, node in calls
        if not any(keyword.arg == "env" for keyword in node.keywords)
    ]
    assert not bare
