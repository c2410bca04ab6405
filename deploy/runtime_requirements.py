"""Prints the entries of requirements.txt that the base install and some extras need, for the container image.

Run it in an environment with all packages of requirements.txt, because it reads the requirements of a package from its
installed metadata.

    python deploy/runtime_requirements.py requirements.txt pyproject.toml sim metrics tls
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = "minivla-factory"


def locked(text: str) -> dict[str, str]:
    """Returns the entries of a requirements file by package; an entry has several lines, one for each hash."""
    entries = re.split(r"(?m)^(?=[A-Za-z0-9])", text)
    return {canonicalize_name(re.match(r"[\w.-]+", entry)[0]): entry for entry in entries if entry.strip()}  # type: ignore[index]


def closure(wanted: Iterable[Requirement], own: dict[str, list[str]]) -> set[str]:
    """Returns the names of all packages that the wanted requirements need on this platform, directly or indirectly.

    Args:
        wanted: the requirements.
        own: requirements of each extra of this project, because an extra can name other extras.
    """
    found: set[tuple[str, str]] = set()
    waiting = [(one, extra) for one in wanted for extra in ("", *one.extras)]
    while waiting:
        one, extra = waiting.pop()
        name = canonicalize_name(one.name)
        if (name, extra) in found:
            continue
        found.add((name, extra))
        for needed in _requirements_of(name, extra, own):
            waiting += [(needed, more) for more in ("", *needed.extras)]
    return {name for name, _ in found} - {PROJECT}


def _requirements_of(name: str, extra: str, own: dict[str, list[str]]) -> Iterator[Requirement]:
    if name == PROJECT:
        lines = own[extra]
    else:
        try:
            lines = requires(name) or []
        except PackageNotFoundError:
            raise SystemExit(f"{name} is not installed here: install requirements.txt first") from None
    for line in lines:
        needed = Requirement(line)
        if needed.marker is None or needed.marker.evaluate({"extra": extra}):
            yield needed


def main(lock: str, project: str, *extras: str) -> None:
    """Prints the locked entries."""
    described = tomllib.loads(Path(project).read_text())["project"]
    own = {"": described["dependencies"], **described["optional-dependencies"]}
    names = closure([Requirement(f"{PROJECT}[{','.join(extras)}]")], own)
    entries = locked(Path(lock).read_text())
    lacking = sorted(names - entries.keys())
    if lacking:
        raise SystemExit(f"{lock} lacks {', '.join(lacking)}: lock the dependencies again")
    sys.stdout.write("".join(entries[name] for name in sorted(names)))


if __name__ == "__main__":
    main(*sys.argv[1:])
