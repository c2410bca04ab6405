"""Hashes of what a policy consists of: source files of a user class, checkpoints, the greeting of a server.

Results of one policy have equal hashes. Loads no policy.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from factory.eval.driving.policy import ServerUnreachable
from factory.eval.models.messages import PolicyLimits
from factory.eval.policies.registry import is_user_class
from factory.eval.policies.remote import RemotePolicy
from schemas.errors import UsageError

GREETING = "greeting of the server"
"""Name of the hash of a server's metadata."""
_OWN = ("factory", "schemas", "workers", "coordinator", "minivla", "__main__", "__mp_main__")
"""Packages of this software, and the module that a driver process runs as, which can be below a working directory."""
_MOST_FILES = 1000
_SHOWN = 12
"""Hexadecimal digits of a hash in messages."""
_NAMED = 4
_PATIENCE_S = 2.0
"""Time for connecting to a server that has results already, and for its greeting, seconds."""

Hashes = dict[str, str]
"""Name of a file (as in the policy's folder), or `GREETING` -> SHA-256."""


def hashes_of(name: str, policy: object, file: Path | None) -> Hashes:
    """Returns the hashes of a policy that has been created in this process.

    For a user class, these are the imported modules of its package, or of the folder of its module, and the files in
    its attribute `files`.

    Args:
        name: name of the policy.
        policy: the policy.
        file: checkpoint of a built-in policy; `None` without one.

    Raises:
        UsageError: a file that the policy names cannot be read, or it names too many.
    """
    if isinstance(policy, RemotePolicy):
        return {GREETING: _of_text(policy.metadata)}
    if file is not None:
        return {file.name: _of_file(name, file)}
    if not is_user_class(name):
        return {}  # the name of a built-in policy can be that of a module, such as `random`
    hashes = {entry: _of_file(name, path) for entry, path in sorted(_modules(name))}
    named = getattr(policy, "files", ())
    for entry in (named,) if isinstance(named, str | Path) else tuple(named):
        hashes[str(entry)] = _of_file(name, Path(str(entry)))
    if len(hashes) > _MOST_FILES:
        raise UsageError(f"policy {name} consists of {len(hashes)} files; at most {_MOST_FILES} are recorded")
    return hashes


def hashes_now(former: Mapping[str, str], folder: Path | None) -> Hashes:
    """Returns the hashes of the files of a policy on disk, before it is created; absent files have none.

    Args:
        former: hashes of the stored results.
        folder: folder that the names of modules are relative to; `None` if it is not known.
    """
    places = [place for place in (folder, Path.cwd()) if place is not None]
    found: Hashes = {}
    for entry in former:
        path = next((place / entry for place in places if (place / entry).is_file()), None)
        if entry != GREETING and path is not None:
            found[entry] = _digest(path)
    return found


def greeting_now(address: str) -> Hashes:
    """Returns the hash of the greeting of a server; empty if the server cannot be reached."""
    try:
        policy = RemotePolicy(address, PolicyLimits(reconnect_s=_PATIENCE_S, load_timeout_s=_PATIENCE_S))
    except ServerUnreachable:
        return {}
    try:
        return hashes_of(address, policy, None)
    finally:
        policy.close()


def changes(former: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Returns a description of each difference, with both hashes."""
    names = sorted({*former, *now})
    return [
        f"{name}: {former.get(name, 'absent')[:_SHOWN]}, now {now.get(name, 'absent')[:_SHOWN]}"
        for name in names
        if former.get(name) != now.get(name)
    ]


def another_policy(name: str, former: Mapping[str, str], now: Mapping[str, str], where: Path) -> UsageError | None:
    """Returns the error for results of another policy with the same name, or `None` if the hashes agree."""
    different = changes(former, now) if former else []
    if not different:
        return None
    shown = "; ".join(different[:_NAMED]) + (f"; and {len(different) - _NAMED} more" if different[_NAMED:] else "")
    return UsageError(
        f"policy {name} is not the one whose results are in {where} ({shown}): give another -o, or --restart, which "
        "moves the former results to the folder `former` there and evaluates the policy as it is now"
    )


def digest_of(hashes: Mapping[str, str]) -> str:
    """Returns one SHA-256 of all hashes."""
    return _of_text(dict(hashes))


def describe(hashes: Mapping[str, str]) -> str:
    """Returns a short text of all hashes; empty without any."""
    if not hashes:
        return ""
    if len(hashes) == 1:
        ((name, value),) = hashes.items()
        return f"{name} {value[:_SHOWN]}"
    return f"{len(hashes)} files {digest_of(hashes)[:_SHOWN]}"


def _modules(name: str) -> Iterator[tuple[str, Path]]:
    """Yields name and path of the imported modules that belong to a user class."""
    top = sys.modules.get(name.partition(":")[0].partition(".")[0])
    if top is None or (not getattr(top, "__file__", None) and not getattr(top, "__path__", None)):
        return
    root = base_of(top)
    inside = Path(next(iter(top.__path__))).resolve() if hasattr(top, "__path__") else root
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if not file or getattr(module, "__name__", "").partition(".")[0] in _OWN:
            continue
        path = Path(file).resolve()
        if path.is_relative_to(inside) and path.is_file() and not _is_installed(path, inside):
            yield path.relative_to(root).as_posix(), path


def base_of(top: ModuleType) -> Path:
    """Returns the folder that contains a package or a module."""
    if hasattr(top, "__path__"):
        return Path(next(iter(top.__path__))).resolve().parent
    return Path(str(top.__file__)).resolve().parent


def _is_installed(path: Path, inside: Path) -> bool:
    """Returns whether a module below the working directory belongs to an environment in it, such as `.venv`."""
    parts = path.relative_to(inside).parts
    return "site-packages" in parts or "dist-packages" in parts


def _of_file(name: str, path: Path) -> str:
    if not path.is_file():
        raise UsageError(f"policy {name} names the file {path}, which does not exist or is not a regular file")
    return _digest(path)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _of_text(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=repr).encode()).hexdigest()
