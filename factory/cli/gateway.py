"""`factory gateway`: starts a router that stores episodes locally, between workers and a remote coordinator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from factory.cli.groups import CommandGroup
from factory.cli.options import (
    connect_option,
    http_options,
    listen_option,
    tls_option,
    verbose_option,
    write_option,
)
from schemas.errors import TransientError, UsageError

if TYPE_CHECKING:
    from coordinator.protocol.tls import Guard
    from factory.web.http_options import HttpOptions

_LISTEN, _TLS_LISTEN = ("tcp/127.0.0.1:7448",), ("tls/0.0.0.0:7447",)
_POLL_S = 0.5


@click.group("gateway", cls=CommandGroup)
def command() -> None:
    """Start a gateway between workers and a coordinator."""


@command.command("start")
@connect_option("Endpoint of the coordinator; repeatable.", required=True)
@write_option(
    "DIR", "Directory of this gateway's episodes. An existing one is continued.", "root", required=True, file_okay=False
)
@listen_option(
    "Endpoint to listen on for workers, repeatable; port 0 selects a free port. Default: tcp/127.0.0.1:7448; with "
    "--tls: tls/0.0.0.0:7447."
)
@click.option(
    "--name", metavar="NAME", help="Name of this gateway. Default: the host name; with --tls: that of the certificate."
)
@tls_option
@http_options
@verbose_option
def start(
    connect: tuple[str, ...],
    root: Path,
    listen: tuple[str, ...],
    name: str | None,
    tls: Path | None,
    pages: HttpOptions,
    verbose: bool,
) -> int:
    """Validate and store the episodes of workers for a coordinator.

    The coordinator keeps the ledger and assigns the jobs; episodes are not sent to it. The gateway runs until it is
    stopped, and then exits with 0 if the run has finished, else with 130. When the run has finished, copy the episodes
    of all gateways into one dataset with `factory gather`.
    """
    from coordinator.gateway.service import Gateway
    from coordinator.settings import CoordinatorSettings
    from factory.support.logs import configure_logs
    from factory.web.serving import status_pages
    from schemas.protocol.address_file import find_endpoints
    from schemas.storage.disk import require_room
    from workers.client.stopping import stop_on_signals

    configure_logs(verbose)
    guard, name, listen = _choose_identity(tls, name, connect, listen)
    connect = find_endpoints(connect)
    settings = CoordinatorSettings()
    require_room(root, settings.reserve_bytes)
    with stop_on_signals() as (stop, _):
        try:
            with (
                Gateway(
                    root, name, connect=connect, listen=listen, settings=settings, guard=guard, stop=stop
                ) as gateway,
                status_pages(gateway, pages),
            ):
                click.echo(f"gateway {name} of run {gateway.run}, storing episodes in {root}", err=True)
                for endpoint in gateway.endpoints:
                    click.echo(f"factory worker --cores 2 --connect {endpoint}")
                while not stop.wait(_POLL_S):
                    gateway.require_no_fault()
                is_finished = gateway.is_finished
        except TransientError:
            if not stop.is_set():
                raise
            click.echo(f"stopped before the coordinator at {', '.join(connect)} answered", err=True)
            return 130
    end = "the run is finished" if is_finished else "stopped before the run was finished"
    click.echo(f"{end}; the episodes of this gateway are in {root}", err=True)
    return 0 if is_finished else 130


def _choose_identity(
    tls: Path | None, name: str | None, connect: tuple[str, ...], listen: tuple[str, ...]
) -> tuple[Guard | None, str, tuple[str, ...]]:
    """Returns the access control (`None` without TLS), the name of the gateway, and the endpoints to listen on."""
    import socket

    from coordinator.protocol.tls import Guard, read_credentials
    from factory.support.listen import require_endpoints, require_loopback, require_tls_endpoints
    from schemas.protocol.identity import require_host_name
    from workers.client.host import valid_host_name

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
