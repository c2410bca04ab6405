"""Version of this product: the release and a digest of its source, so two commits of one release differ."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import version
from pathlib import Path

PRODUCT = "minivla-factory"
_PACKAGES = ("coordinator", "factory", "minivla", "schemas", "workers")
_SUFFIXES = frozenset({".py", ".toml", ".yaml", ".glsl", ".json"})
_DIGITS = 10


@cache
def product_version() -> str:
    """Returns the release and the first digits of the digest of the source, such as `0.2.0+4f1d20ab63`.

    Machines with equal versions simulate the same episodes from the same jobs.
    """
    # 20 ms; the commit is not known to an installed package, and does not name uncommitted edits
    return f"{version(PRODUCT)}+{source_digest(Path(__file__).parents[2])[:_DIGITS]}"


def why_refused(peer: str, theirs: str, their_protocol: int, *, mine: str, my_protocol: int) -> str:
    """Returns why a peer of another version is refused: both versions, which side is older, and what to do.

    Args:
        peer: the peer, such as `worker node-07.1`.
        theirs: version of the peer.
        their_protocol: version of the messages of the peer.
        mine: version of the coordinator.
        my_protocol: version of the messages of the coordinator.
    """
    found = f"{peer} runs minivla-factory {theirs or 'of unknown version'}, the coordinator {mine}"
    if their_protocol != my_protocol:
        found += f", with protocol {their_protocol} and {my_protocol}"
    role = peer.partition(" ")[0]
    install = f"install {mine} for the {role}"
    their_age, my_age = (their_protocol, _release(theirs)), (my_protocol, _release(mine))
    if their_age < my_age:
        return f"{found}; the {role} is older: {install}"
    if their_age > my_age:
        return (
            f"{found}; the coordinator is older: {install}, or stop the coordinator, install {theirs} there and start "
            "it again"
        )
    return f"{found}; the release is the same, the source differs: {install} (`factory --version` prints the version)"


def _release(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.partition("+")[0].split(".") if part.isdecimal())


def source_digest(root: Path) -> str:
    """Returns the SHA-256 of the names and contents of the source files of the packages in a folder."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.suffix in _SUFFIXES and path.is_file():
                content = path.read_bytes()
                digest.update(f"{path.relative_to(root).as_posix()}\n{len(content)}\n".encode())
                digest.update(content)
    return digest.hexdigest()
