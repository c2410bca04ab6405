"""Runs a private PostgreSQL server on loopback in a temporary folder; it is deleted at exit."""

from __future__ import annotations

import itertools
import os
import pwd
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import create_engine, text

from tests.builders.ports import free_port

_USER = "factory"


def why_no_postgres() -> str:
    """Returns why no PostgreSQL server can be started; empty if one can be started."""
    try:
        import psycopg  # noqa: F401
    except ImportError:
        return "needs psycopg (pip install 'psycopg[binary]')"
    if _tool("initdb") is None:
        return "needs a PostgreSQL server (Debian: postgresql)"
    if os.geteuid() == 0 and _other_user() is None:
        return "PostgreSQL does not run as root, and there is no other user"
    return ""


class Postgres:
    """A running server."""

    def __init__(self, port: int, control: Callable[[str], None] = lambda _: None) -> None:
        self._port, self._control = port, control
        self._numbers = itertools.count(1)

    def url(self, database: str) -> str:
        """Returns the URL of a database."""
        return f"postgresql+psycopg://{_USER}@127.0.0.1:{self._port}/{database}"

    def stop(self) -> None:
        """Stops the server at once, which ends all connections."""
        self._control("stop")

    def start(self) -> None:
        """Starts the server again after `stop`."""
        self._control("start")

    def new_database(self) -> str:
        """Creates an empty database and returns its URL."""
        name = f"run_{next(self._numbers)}"
        engine = create_engine(self.url("postgres"), isolation_level="AUTOCOMMIT")
        with engine.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name} TEMPLATE template0"))
        engine.dispose()
        return self.url(name)


@contextmanager
def postgres() -> Iterator[Postgres]:
    """Runs a server until the end of the `with` block."""
    folder = Path(tempfile.mkdtemp(prefix="minivla-postgres-"))
    user = _other_user() if os.geteuid() == 0 else None
    as_user = {} if user is None else {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
    if user is not None:
        os.chown(folder, user.pw_uid, user.pw_gid)
    port = free_port()
    data = folder / "data"
    settings = f"-h 127.0.0.1 -p {port} -k {folder} -c fsync=off -c shared_buffers=16MB -c max_connections=40"
    environment = {"PATH": os.environ["PATH"], "LC_ALL": "C", "HOME": str(folder)}

    def run(*words: object) -> None:
        command = [_tool(str(words[0])) or str(words[0]), *map(str, words[1:])]
        subprocess.run(command, check=True, capture_output=True, env=environment, cwd=folder, **as_user)  # type: ignore[call-overload]

    def control(what: str) -> None:
        if what == "stop":
            run("pg_ctl", "stop", "-m", "fast", "-D", data)
        else:
            run("pg_ctl", "start", "-w", "-D", data, "-l", folder / "log", "-o", settings)

    try:
        run("initdb", "--no-sync", "--auth=trust", "--username", _USER, "--encoding=UTF8", "-D", data)
        control("start")
        try:
            yield Postgres(port, control)
        finally:
            run("pg_ctl", "stop", "-m", "immediate", "-D", data)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _tool(name: str) -> str | None:
    found = shutil.which(name)
    if found is not None:
        return found
    versions = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))
    return str(versions[-1]) if versions else None


def _other_user() -> pwd.struct_passwd | None:
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name)
        except KeyError:
            continue
    return None
