"""Reads a TLS folder: credentials and admission list. Builds no configuration and opens no socket."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from schemas.errors import UsageError
from schemas.protocol.identity import Role, TlsFiles, parse_admitted, tls_files

_WORLD_BITS = 0o007
_AT_GATEWAY = frozenset({Role.WORKER, Role.COORDINATOR})


@dataclass(frozen=True)
class Guard:
    """TLS credentials and admission list of a coordinator or gateway; each call of `admitted` reads the list again.

    Args:
        folder: folder made by `factory keys host DIR NAME --role coordinator`, or `--role gateway`.
        of_gateway: whether the folder belongs to a gateway, which admits workers and its coordinator only.
        listens: whether the process listens; a client needs no admission list.

    Raises:
        UsageError: a file is missing, or other users can read the key.
    """

    folder: Path
    of_gateway: bool = False
    listens: bool = True
    files: TlsFiles = field(init=False)
    name: str = field(init=False)
    """Common name of the certificate."""

    def __post_init__(self) -> None:
        files, name = read_credentials(self.folder)
        object.__setattr__(self, "files", files)
        object.__setattr__(self, "name", name)
        self.admitted()

    def admitted(self) -> Mapping[str, Role]:
        """Returns the admission list: role by common name.

        Raises:
            UsageError: the list is missing or invalid.
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

    def role_of(self, host: str) -> Role | None:
        """Returns the role of a host in the admission list; `None` if it is not listed, or the list is invalid now."""
        try:
            return self.admitted().get(host)
        except UsageError:
            return None


def read_credentials(folder: Path) -> tuple[TlsFiles, str]:
    """Returns the files of a TLS folder and the common name of its certificate.

    Raises:
        UsageError: a file is missing, or other users can read the key.
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
