"""The command that installs an extra suits the installation, and the table of extras agrees with pyproject.toml."""

from __future__ import annotations

import re
import shlex
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from schemas.errors import UsageError
from schemas.support.extras import (
    EXTRA_OF,
    direct_url,
    install_command,
    missing_package,
    require_package,
    requirement_of,
)

ROOT = Path(__file__).parents[4]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MODULE_OF = {
    "eclipse-zenoh": "zenoh",
    "mapbox_earcut": "mapbox_earcut",
    "usd-core": "pxr",
    "pycollada": "collada",
    "mujoco-core": "mujoco",
    "rerun-sdk": "rerun",
    "psycopg": "psycopg",
}


@pytest.mark.parametrize(
    ("origin", "wanted"),
    [
        (None, "minivla-factory[sim]"),
        ({"url": "file:///src/my clone", "dir_info": {"editable": True}}, "-e /src/my clone[sim]"),
        ({"url": "file:///src/my%20clone", "dir_info": {"editable": True}}, "-e /src/my clone[sim]"),
        ({"url": "file:///src", "dir_info": {}}, "/src[sim]"),
        ({"url": "file:///d/m.whl", "archive_info": {}}, "minivla-factory[sim] @ file:///d/m.whl"),
        (
            {"url": "https://h/r.git", "vcs_info": {"vcs": "git", "commit_id": "abc"}},
            "minivla-factory[sim] @ git+https://h/r.git@abc",
        ),
    ],
)
def test_the_install_requirement_matches_the_source_of_the_installation(
    origin: dict[str, Any] | None, wanted: str
) -> None:
    assert " ".join(shlex.split(requirement_of("sim", origin))) == wanted


def test_command_of_this_installation_can_be_pasted_into_a_shell() -> None:
    words = shlex.split(install_command("train"))
    assert words[:4] == [sys.executable, "-m", "pip", "install"]
    assert words[-1].endswith("[train]") or "[train] @ " in words[-1]
    assert direct_url() is None or "url" in (direct_url() or {})


def test_missing_package_is_named_with_the_feature_that_needs_it_and_the_install_command() -> None:
    with pytest.raises(UsageError, match=re.escape(install_command("view"))) as raised:
        raise missing_package("rerun", "`factory view`")
    assert str(raised.value).startswith("`factory view` needs the package rerun, which is not installed")
    with pytest.raises(UsageError, match="needs the package nowhere_at_all"):
        require_package("nowhere_at_all", "a test")
    require_package("numpy", "a test")


def test_the_error_of_missing_pybullet_explains_that_this_python_has_no_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 13, 0))
    text = str(missing_package("pybullet", "`factory run`"))
    assert "wheels for Python 3.9 to 3.11 only, and this is Python 3.13.0" in text
    assert "python3.11 -m venv" in text


def test_each_optional_package_is_in_its_extra() -> None:
    extras: dict[str, list[str]] = PROJECT["optional-dependencies"]
    brought = {
        MODULE_OF.get(name, name).replace("-", "_"): extra
        for extra, requirements in extras.items()
        if extra not in {"dev", "scenes"}
        for name in map(_name, requirements)
        if name != "minivla-factory"
    }
    brought |= dict.fromkeys(("mapbox_earcut", "pxr", "defusedxml", "collada"), "sim")
    assert dict(EXTRA_OF) == brought


def test_base_install_has_no_package_that_only_simulation_needs() -> None:
    base = set(map(_name, PROJECT["dependencies"]))
    assert not base & {"pybullet", "eclipse-zenoh", "embreex", "sqlalchemy"}
    assert "<" not in PROJECT["requires-python"]


def test_messages_contain_no_command_that_requires_an_index() -> None:
    sources = [
        path
        for folder in ("factory", "coordinator", "workers", "schemas", "minivla")
        for path in sorted((ROOT / folder).rglob("*.py"))
    ]
    assert not [str(path) for path in sources if "pip install 'minivla-factory" in path.read_text()]


def _name(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9_.-]+", requirement)
    assert found is not None
    return found[0].lower()
