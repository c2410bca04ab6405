"""`factory keys`: creates a certificate authority and the certificates of hosts, and admits and revokes hosts."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import click

from factory.commands.common.output import print_json, print_table
from factory.keys import HostKeys, admit, create_authority, list_hosts, revoke
from schemas.protocol.identity import Role


def ca(folder: Path, name: str, days: int, as_json: bool) -> None:
    """Executes `factory keys ca`."""
    create_authority(folder, name, days, datetime.now(UTC))
    if as_json:
        print_json({"authority": str(folder), "key": str(folder / "ca.key"), "certificate": str(folder / "ca.pem")})
    else:
        click.echo(f"authority in {folder}; next: factory keys host {folder} NAME --role coordinator --address ADDRESS")


def host(folder: Path, name: str, role: str, address: tuple[str, ...], days: int, renew: bool, as_json: bool) -> None:
    """Executes `factory keys host`."""
    place = admit(folder, name, Role(role), address, days, datetime.now(UTC), renew=renew)
    if as_json:
        print_json({"host": name, "role": role, "folder": str(place)})
    else:
        click.echo(f"{role} {name}: pass {place} with --tls on that host; copy the folder there if it is not shared")


def revoke_(folder: Path, name: str, as_json: bool) -> None:
    """Executes `factory keys revoke`."""
    lists = [str(path) for path in revoke(folder, name)]
    if as_json:
        print_json({"revoked": name, "lists": lists})
    else:
        click.echo(
            f"{name} is revoked; copy the updated lists to coordinators and gateways on other machines: "
            f"{', '.join(lists) or 'none'}"
        )


def list_(folder: Path, as_json: bool) -> None:
    """Executes `factory keys list`."""
    hosts = list_hosts(folder)
    if as_json:
        print_json([_plain(keys) for keys in hosts])
        return
    rows = [(k.name, k.role, "yes" if k.admitted else "no", f"{k.expires:%Y-%m-%d}", k.folder) for k in hosts]
    print_table("", ("host", "role", "admitted", "expires", "folder"), rows)


def _plain(keys: HostKeys) -> dict[str, Any]:
    return keys._asdict() | {"expires": keys.expires.isoformat(), "folder": str(keys.folder)}
