"""Declares `factory keys`: arguments, options and help."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from factory.cli.common.groups import CommandGroup
from factory.cli.common.options import count_option, json_option
from schemas.protocol.identity import Role

Command = TypeVar("Command", bound=Callable[..., Any])
_folder_argument = click.argument("folder", metavar="DIR", type=click.Path(path_type=Path, file_okay=False))


def _days_option(default: int) -> Callable[[Command], Command]:
    return count_option("--days", default, "Validity period of the certificate, days.", most=36500)


@click.group("keys", cls=CommandGroup)
def command() -> None:
    """Create and list the TLS certificates of hosts.

    \b
    factory keys ca pki
    factory keys host pki hub --role coordinator --address hub.example.org
    factory keys host pki gw1 --role gateway --address 10.0.1.1
    factory keys host pki node-07
    factory keys host pki desk --role evaluator

    Then copy pki/hub, pki/gw1, pki/node-07 and pki/desk to the hosts, and pass each folder with --tls.
    """


@command.command("ca")
@_folder_argument
@click.option(
    "--name", default="minivla-factory", show_default=True, metavar="NAME", help="Name in the authority's certificate."
)
@_days_option(3650)
@json_option
def ca(**options: Any) -> None:
    """Create a certificate authority.

    DIR is the directory to create. Keep DIR/ca.key secret.
    """
    from factory.commands.farm.keys import ca

    ca(**options)


@command.command("host")
@_folder_argument
@click.argument("name")
@click.option(
    "--role",
    type=click.Choice([str(role) for role in Role]),
    default=str(Role.WORKER),
    show_default=True,
    help="Role of the host. It determines which requests the host may send.",
)
@click.option(
    "--address",
    multiple=True,
    metavar="ADDRESS",
    help="Host name or IP address at which other hosts connect to it; repeatable. Required for the roles coordinator "
    "and gateway.",
)
@_days_option(365)
@click.option("--renew", is_flag=True, help="Replace the existing certificate of this host.")
@json_option
def host(**options: Any) -> None:
    """Create the TLS folder of a host and admit the host.

    DIR is the directory of the authority. NAME is the host's name; the folder is DIR/NAME.
    """
    from factory.commands.farm.keys import host

    host(**options)


@command.command("revoke")
@_folder_argument
@click.argument("name")
@json_option
def revoke_(**options: Any) -> None:
    """Revoke the admission of a host.

    DIR is the directory of the authority. Updates the list of admitted hosts in the TLS folders of coordinators and
    gateways below DIR, which apply it within seconds. Copy the list to coordinators and gateways on other machines.
    """
    from factory.commands.farm.keys import revoke_

    revoke_(**options)


@command.command("list")
@_folder_argument
@json_option
def list_(**options: Any) -> None:
    """List the hosts that have certificates.

    DIR is the directory of the authority.
    """
    from factory.commands.farm.keys import list_

    list_(**options)
