"""Creates an authority, a coordinator and hosts with certificates through the product."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from factory.keys import admit, create_authority
from schemas.protocol.identity import Role, TlsFiles, tls_files


def make_authority(
    folder: Path,
    workers: Sequence[str] = (),
    operators: Sequence[str] = (),
    days: int = 2,
    gateways: Sequence[str] = (),
    evaluators: Sequence[str] = (),
) -> Path:
    """Returns the folder of an authority that has signed certificates of a coordinator named hub and of the hosts."""
    now = datetime.now(UTC)
    create_authority(folder, "test", days, now)
    admit(folder, "hub", Role.COORDINATOR, (), days, now)
    named = {
        Role.WORKER: workers,
        Role.OPERATOR: operators,
        Role.GATEWAY: gateways,
        Role.EVALUATOR: evaluators,
    }
    for role, names in named.items():
        for name in names:
            admit(folder, name, role, (), days, now)
    return folder


def files_of(folder: Path, name: str) -> TlsFiles:
    """Returns a host's files below its authority's folder."""
    return tls_files(folder / name)
