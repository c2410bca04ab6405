"""`factory gateway`: starts a router that stores episodes locally, between workers and a remote coordinator."""

from __future__ import annotations

import socket
from pathlib import Path

import click

from coordinator.gateway.service import Gateway
from coordinator.protocol.tls import Guard, read_credentials
from coordinator.settings import CoordinatorSettings
from factory.commands.common.http import status_pages
from factory.support.listen import require_endpoints, require_loopback, require_tls_endpoints
from factory.support.logs import configure_logs
from schemas.errors import TransientError, UsageError
from schemas.protocol.address_file import find_endpoints
from schemas.protocol.identity import require_host_name
from schemas.storage.disk import require_room
from workers.client.host import valid_host_name
from workers.client.stopping import stop_on_signals

_LISTEN, _TLS_LISTEN = ("tcp/127.0.0.1:7448",), ("tls/0.0.0.0:7447",)
_POLL_S = 0.5


def start(
    connect: tuple[str, ...],
    root: Path,
    listen: tuple[str, ...],
    name: str | None,
    tls: Path | None,
    http: str | None,
    http_token: Path | None,
    verbose: bool,
) -> int:
    """Executes `factory gateway start`."""
    configure_logs(verbose)
    guard, name, listen = _choose_identity(tls, name, connect, listen)
    connect = find_endpoints(connect)
    settings = CoordinatorSettings()
    require_room(root, settings.reserve_bytes)
    with stop_on_signals() as (stop, _):
        try:
            with (
                Gateway(root, name, connect, listen, settings, guard=guard, stop=stop) as gateway,
                status_pages(gateway, http, http_token),
            ):
                click.echo(f"gateway {name} of run {gateway.run}, storing episodes in {root}", err=True)
                for endpoint in gateway.endpoints:
                    click.echo(f"factory worker --cores 2 --connect {endpoint}")
                while not stop.wait(_POLL_S):
                    pass
        except TransientError:
            if not stop.is_set():
                raise
            click.echo(f"stopped before the coordinator at {', '.join(connect)} answered", err=True)
            return 130
    click.echo(f"stopped; the episodes of this gateway are in {root}", err=True)
    return 0


def _choose_identity(
    tls: Path | None, name: str | None, connect: tuple[str, ...], listen: tuple[str, ...]
) -> tuple[Guard | None, str, tuple[str, ...]]:
    """Returns the access control (`None` without TLS), the name of the gateway, and the endpoints to listen on."""
    require_endpoints(connect, with_tls=tls is not None)
    if tls is None:
        require_loopback(listen)
        return None, require_host_name(name or valid_host_name(socket.gethostname())), listen or _LISTEN
    require_tls_endpoints(listen)
    certified = read_credentials(tls)[1]
    if name not in (None, certified):
        raise UsageError(
            f"--name {name!r} does not match the certificate in {tls}, which is for {certified!r}: remove --name"
        )
    return Guard(tls, of_gateway=True), certified, listen or _TLS_LISTEN
