"""Reads the TLS folder of one side: its certificate, and whom it admits. Builds no configuration, opens no socket."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from schemas.errors import UsageError
from schemas.identity import Role, TlsFiles, parse_admitted, tls_files

__all__ = ["Guard", "read_credentials"]

_WORLD_BITS = 0o007
_AT_GATEWAY = frozenset({Role.WORKER, Role.COORDINATOR})


@dataclass(frozen=True)
class Guard:
    """The door of a coordinator or gateway; `admitted` is read anew whenever asked.

    Args:
        folder: as `factory keys host DIR NAME --role coordinator` makes it, or `--role gateway`.
        of_gateway: whether it is a gateway's: that knows workers and its coordinator, and nobody else.
        listens: whether anybody is let in; who only connects needs no list.

    Raises:
        UsageError: a file is missing, or the key can be read by everybody.
    """

    folder: Path
    of_gateway: bool = False
    listens: bool = True
    files: TlsFiles = field(init=False)
    name: str = field(init=False)
    """In the certificate."""

    def __post_init__(self) -> None:
        files, name = read_credentials(self.folder)
        object.__setattr__(self, "files", files)
        object.__setattr__(self, "name", name)
        self.admitted()

    def admitted(self) -> Mapping[str, Role]:
        """Returns who may connect, by common name.

        Raises:
            UsageError: the list is missing or cannot be understood.
        """
        if not self.listens:
            return {}
        try:
            text = self.files.admitted.read_text(encoding="ascii")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(
                f"{self.files.admitted} cannot be read ({error}): a coordinator or gateway needs a --tls folder "
                "created by "
                f"`factory keys host DIR NAME --role {Role.GATEWAY if self.of_gateway else Role.COORDINATOR}`"
            ) from error
        try:
            named = parse_admitted(text, of_gateway=self.of_gateway)
        except UsageError as error:
            raise UsageError(f"{self.files.admitted}: {error}") from error
        return {name: role for name, role in named.items() if role in _AT_GATEWAY} if self.of_gateway else named


def read_credentials(folder: Path) -> tuple[TlsFiles, str]:
    """Returns the files of a TLS folder and the name in its certificate.

    Raises:
        UsageError: a file is missing, or the key can be read by everybody.
    """
    files = tls_files(folder)
    try:
        missing = [path.name for path in (files.ca, files.certificate, files.key, files.name) if not path.is_file()]
        if missing:
            raise UsageError(f"{folder} lacks {', '.join(missing)}: give a folder created by `factory keys host`")
        if files.key.stat().st_mode & _WORLD_BITS:
            raise UsageError(f"{files.key} is readable by other users: run chmod 600 {files.key}")
        return files, files.name.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{folder} cannot be read: {error}") from error
