"""Settings of a worker: endpoints, simulation command and disk limits. Contains values only."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import platformdirs

from schemas.errors import WorldError
from schemas.job import Job
from schemas.protocol.identity import TlsFiles
from schemas.protocol.messages import RunKind
from schemas.support.child import python_module
from schemas.terms import RendererKind

_SPARE_BUNDLES = 8

CheckBundle = Callable[[Path, Job], object]
"""Function that validates the bundle of a job; raises `InvalidBundle` or `TransientError`."""


def _cache(name: str) -> Path:
    chosen = os.environ.get("MINIVLA_CACHE")
    return (Path(chosen) if chosen else platformdirs.user_cache_path("minivla-factory")) / name


@dataclass(frozen=True)
class WorkerSettings:
    """Settings that may differ between workers; they do not change the bytes of the dataset."""

    connect: tuple[str, ...]
    """Endpoints of coordinators or gateways of one run, e.g. `tcp/10.0.0.1:7447`; one of them is enough."""
    cores: int = 1
    """Number of simulations that run at the same time."""
    renderer: RendererKind = "auto"
    """Renderer of the simulations."""
    run: str | None = None
    """Name of the run to work for; `None` selects the run that answers."""
    host: str | None = None
    """Name by which the coordinator identifies this machine; `None` selects the system's name. With TLS, it must be the
    common name of the certificate."""
    tls: TlsFiles | None = None
    """TLS files of this machine, or `None` for plain TCP."""
    spool_dir: Path = field(default_factory=lambda: _cache("spool"))
    """Folder of finished bundles that the coordinator has not archived yet."""
    scene_dir: Path = field(default_factory=lambda: _cache("fetched"))
    """Folder of compiled scenes by digest; all workers of the host may share it."""
    hang_s: float = 60.0
    """Time without progress after which a simulation is killed as hung, scene loading included, seconds."""
    start_s: float = 60.0
    """Time without a report after which a starting simulation is killed, seconds."""
    pause_s: float = 1.0
    """Pause of a simulation slot after a crash, a hang or a release, seconds; it doubles with each consecutive failure,
    up to one minute."""
    wait_s: float = 30.0
    """Timeout for finding a coordinator at the start, seconds; later, a worker waits without limit."""
    max_bundles: int | None = None
    """Largest number of bundles in the spool; `None` selects two per core plus eight. A full spool pauses the
    simulations."""
    max_spool_bytes: int = 16 << 30
    """Largest size of the spool, bytes."""
    min_free_bytes: int = 512 << 20
    """Free space on the spool's disk below which simulations pause, bytes."""
    max_scene_bytes: int = 4 << 30
    """Largest size of the scene cache, bytes."""
    command: tuple[str, ...] = ()
    """Command line of a simulation process; empty selects the default."""
    check_bundle: CheckBundle | None = None
    """Function that validates a bundle, in another process; `None` if this worker cannot validate its bundles."""
    eval_command: tuple[str, ...] = ()
    """Command line of a process that executes evaluation tasks; if empty, the worker rejects evaluations."""
    build_command: tuple[str, ...] = ()
    """Command line of a process that builds layouts; if empty, the worker claims no builds."""

    @property
    def simulation_command(self) -> tuple[str, ...]:
        return self.command or python_module("workers.sim.simulate", "--renderer", self.renderer)

    def command_for(self, run_kind: RunKind) -> tuple[str, ...]:
        """Returns the command line of a process that executes the jobs of a run.

        Raises:
            WorldError: this worker cannot execute jobs of that type.
        """
        if run_kind is RunKind.COLLECTION:
            return self.simulation_command
        if not self.eval_command:
            raise WorldError(f"the run is an {run_kind}, and this worker has no eval_command: use `factory worker`")
        return self.eval_command

    @property
    def spool_limit(self) -> int:
        """Largest number of bundles in the spool."""
        return self.max_bundles if self.max_bundles is not None else 2 * self.cores + _SPARE_BUNDLES
