"""What a worker may be told: where to connect, what to run, and how much of the disk to use. Holds values only."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import platformdirs

from schemas.errors import WorldError
from schemas.identity import TlsFiles
from schemas.support.child import python_module
from schemas.terms import RendererKind
from schemas.wire import Trade

__all__ = ["WorkerSettings"]

_SPARE_BUNDLES = 8


def _cache(name: str) -> Path:
    chosen = os.environ.get("MINIVLA_CACHE")
    return (Path(chosen) if chosen else platformdirs.user_cache_path("minivla-factory")) / name


@dataclass(frozen=True)
class WorkerSettings:
    """Everything that may differ between two workers without changing a byte of the dataset."""

    connect: tuple[str, ...]
    """Endpoints of coordinators or gateways of one run, e.g. `tcp/10.0.0.1:7447`; one of them is enough."""
    cores: int = 1
    """Simulations at a time."""
    renderer: RendererKind = "auto"
    run: str | None = None
    """Name of the run to work for; `None` takes the one that answers."""
    host: str | None = None
    """Name of this machine towards the coordinator; `None` takes the system's. With TLS the name in the certificate."""
    tls: TlsFiles | None = None
    """To connect with; `None` for plain TCP."""
    spool_dir: Path = field(default_factory=lambda: _cache("spool"))
    """Finished bundles wait here until the coordinator has them."""
    scene_dir: Path = field(default_factory=lambda: _cache("fetched"))
    """Compiled scenes by digest; may be shared by all workers of the host."""
    hang_s: float = 60.0
    """Silence after which a simulation counts as hung, loading its scene included."""
    wait_s: float = 30.0
    """How long to look for a coordinator at the start; afterwards a worker waits for ever."""
    max_bundles: int | None = None
    """Bundles that may wait; `None` takes two a core and eight more. A full spool stops the simulations."""
    max_spool_bytes: int = 16 << 30
    min_free_bytes: int = 512 << 20
    """Free space on the spool's disk below which nothing is simulated."""
    max_scene_bytes: int = 4 << 30
    command: tuple[str, ...] = ()
    """How to start a simulation; empty takes our own."""
    errand_command: tuple[str, ...] = ()
    """How to start what carries out errands; empty refuses runs of errands."""

    @property
    def simulation_command(self) -> tuple[str, ...]:
        """The command line of a simulation process."""
        return self.command or python_module("workers.sim.simulate", "--renderer", self.renderer)

    def command_for(self, trade: Trade) -> tuple[str, ...]:
        """Returns the command line of a process that does the jobs of a run.

        Raises:
            WorldError: this worker cannot do such jobs.
        """
        if trade is Trade.COLLECTION:
            return self.simulation_command
        if not self.errand_command:
            raise WorldError(f"the run is an {trade}, and this worker has no errand_command: use `factory worker`")
        return self.errand_command

    @property
    def spool_limit(self) -> int:
        """Bundles that may wait."""
        return self.max_bundles if self.max_bundles is not None else 2 * self.cores + _SPARE_BUNDLES
