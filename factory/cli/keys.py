"""`factory keys`: creates a certificate authority and the certificates of hosts, and admits and revokes hosts."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import click

from factory.cli.groups import CommandGroup
from factory.cli.options import Command, count_option, json_option
from schemas.protocol.identity import Role
from schemas.support.shell import quoted

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
def ca(folder: Path, name: str, days: int, as_json: bool) -> None:
    """Create a certificate authority.

    DIR is the directory to create. Keep DIR/ca.key secret.
    """
    from factory.keys import create_authority
    from factory.support.terminal import print_json

    create_authority(folder, name, days, datetime.now(UTC))
    if as_json:
        print_json({"authority": str(folder), "key": str(folder / "ca.key"), "certificate": str(folder / "ca.pem")})
    else:
        click.echo(
            f"authority in {folder}; next: factory keys host {quoted(folder)} NAME --role coordinator --address ADDRESS"
        )


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
def host(folder: Path, name: str, role: str, address: tuple[str, ...], days: int, renew: bool, as_json: bool) -> None:
    """Create the TLS folder of a host and admit the host.

    DIR is the directory of the authority. NAME is the host's name; the folder is DIR/NAME.
    """
    from factory.keys import admit
    from factory.support.terminal import print_json

    place = admit(folder, name, Role(role), address, days, datetime.now(UTC), renew=renew)
    if as_json:
        print_json({"host": name, "role": role, "folder": str(place)})
    else:
        click.echo(f"{role} {name}: pass {place} with --tls on that host; copy the folder there if it is not shared")


@command.command("revoke")
@_folder_argument
@click.argument("name")
@json_option
def revoke_(folder: Path, name: str, as_json: bool) -> None:
    """Revoke the admission of a host.

    DIR is the directory of the authority. Updates the list of admitted hosts in the TLS folders of coordinators and
    gateways below DIR, which apply it within seconds. Copy the list to coordinators and gateways on other machines.
    """
    from factory.keys import revoke
    from factory.support.terminal import print_json

    lists = [str(path) for path in revoke(folder, name)]
    if as_json:
        print_json({"revoked": name, "lists": lists})
    else:
        click.echo(
            f"{name} is revoked; copy the updated lists to coordinators and gateways on other machines: "
            f"{', '.join(lists) or 'none'}"
        )


@command.command("list")
@_folder_argument
@json_option
def list_(folder: Path, as_json: bool) -> None:
    """List the hosts that have certificates.

    DIR is the directory of the authority.
    """
    from factory.keys import list_hosts
    from factory.support.terminal import print_json, print_table

    hosts = list_hosts(folder)
    if as_json:
        plain = [{**keys._asdict(), "expires": keys.expires.isoformat(), "folder": str(keys.folder)} for keys in hosts]
        print_json(plain)
        return
    rows = [(k.name, k.role, "yes" if k.admitted else "no", f"{k.expires:%Y-%m-%d}", k.folder) for k in hosts]
    print_table("", ("host", "role", "admitted", "expires", "folder"), rows)
