"""Workers of a run on a Ray cluster: one supervisor actor for each node, which Ray places and restarts.

The coordinator stays in the process of `factory run`. Each node gets a certificate of this run, as bytes.
"""

from __future__ import annotations

import logging
import secrets
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import structlog

from coordinator.protocol.tls import Guard
from factory.keys import admit, create_authority
from factory.runs.ray_worker import PREFIX, RayWorker, Scratch, memory_folder, remove_stale
from schemas.errors import UsageError, WorldError
from schemas.protocol.identity import Role
from schemas.protocol.reachability import why_unreachable
from schemas.support.closing import Closing
from schemas.support.extras import require_package
from schemas.terms import RendererKind

_DAYS = 30
_MOST_CHARS = 200
_QUERY_PAUSE_S = 2.0
"""Pause between two queries for the nodes of the cluster, seconds."""
_MOST_DEATHS = 8
"""Maximum number of workers that exit with an error without a new episode; after more, the run stops with an error."""
_LEAVE_S = 10.0
_HUB = "hub"
_NAMED_CLUSTERS = ("auto", "local")
"""Addresses of Ray that name no host."""

log = structlog.get_logger(__name__)


@dataclass
class _Node:
    """Actor of a node, with its running task."""

    actor: Any
    task: Any


class RayCluster(Closing):
    """Connection to a Ray cluster, with an authority for the certificates of its nodes.

    Args:
        address: Address of the cluster; `None` uses `RAY_ADDRESS`, or starts a cluster on this machine.
        keys: New folder for the certificates.
        cores: Number of simulation processes of each node; `None` uses all CPUs of the node.
        renderer: Renderer of the simulations.

    Raises:
        UsageError: Ray or the package for certificates is missing, the address is not valid, or no cluster answers.
    """

    def __init__(self, address: str | None, keys: Path, cores: int | None, renderer: RendererKind) -> None:
        require_package("ray", "`--engine ray`")
        require_package("cryptography", "`--engine ray`")
        require_reachable(address)
        import ray

        self._ray: Any = ray
        self._cores, self._renderer, self._keys = cores, renderer, keys
        self._deaths = self._archived = 0
        self._nodes: dict[str, _Node] = {}
        self._looked = float("-inf")
        self._endpoint = ""
        try:
            self._ray.init(address=address, log_to_driver=True, include_dashboard=False, logging_level=logging.WARNING)
        except ConnectionError as error:
            raise UsageError(
                f"no Ray cluster answers at {address}: {error}; start one with `ray start --head`"
            ) from error
        now, host = datetime.now(UTC), self._ray.util.get_node_ip_address()
        create_authority(keys, "ray", _DAYS, now)
        self.guard = Guard(admit(keys, _HUB, Role.COORDINATOR, (host,), _DAYS, now))
        """Credentials and admission list of the coordinator."""
        self.listen = (f"tls/{host}:0",)
        """Endpoint of the coordinator: the address of this machine that the cluster uses."""

    def open(self, endpoint: str) -> None:
        """Starts a worker on every node; call after the coordinator listens."""
        self._endpoint = endpoint
        self.restart_dead(0)

    def restart_dead(self, archived: int) -> None:
        """Starts workers on new nodes, and restarts workers that exited with an error.

        Args:
            archived: Number of archived episodes.

        Raises:
            WorldError: Workers exited repeatedly without a new episode.
        """
        if archived > self._archived:
            self._archived, self._deaths = archived, 0
        self._collect_ended()
        if time.monotonic() - self._looked < _QUERY_PAUSE_S:
            return
        self._looked = time.monotonic()
        for node in self._ray.nodes():
            cpus = int(node["Resources"].get("CPU", 0))
            if node["Alive"] and cpus and node["NodeID"] not in self._nodes:
                self._nodes[node["NodeID"]] = self._start(node["NodeID"], min(self._cores or cpus, cpus))

    def _collect_ended(self) -> None:
        tasks = {one.task: name for name, one in self._nodes.items()}
        if not tasks:
            return
        ended, _ = self._ray.wait(list(tasks), num_returns=len(tasks), timeout=0)
        for task in ended:
            name = tasks[task]
            status = self._status_of(task)
            if status == 0:
                continue
            one = self._nodes.pop(name)
            self._ray.kill(one.actor)
            log.warning("ray_worker_ended", node=name[:12], status=status, remedy="none; the worker is restarted")
            self._deaths += isinstance(status, int)
            if self._deaths > _MOST_DEATHS:
                raise WorldError(f"workers exited {self._deaths} times without an episode, last with status {status}")

    def _status_of(self, task: Any) -> int | str:
        """Returns the exit status of a worker, or the reason why its actor or node was lost."""
        try:
            return int(self._ray.get(task))
        except self._ray.exceptions.RayError as error:
            return (str(error).splitlines() or [type(error).__name__])[0][:_MOST_CHARS]

    def _start(self, node_id: str, cores: int) -> _Node:
        name = f"ray-{node_id[:12]}"
        folder = admit(self._keys, name, Role.WORKER, (), _DAYS, datetime.now(UTC), renew=True)
        place = self._ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(node_id, soft=False)
        options = {"num_cpus": cores, "max_concurrency": 2, "max_restarts": -1, "max_task_retries": -1}
        actor: Any = (
            self._ray.remote(RayWorker)
            .options(**options, scheduling_strategy=place)
            .remote(self._endpoint, _contents(folder), cores, self._renderer)
        )
        log.info("ray_worker_started", node=name, cores=cores)
        return _Node(actor, actor.run.remote())

    def close(self) -> None:
        """Ends the actors, which end their workers, and the connection to the cluster."""
        stopping = [one.actor.stop.remote() for one in self._nodes.values()]
        if stopping:
            self._ray.wait(stopping, num_returns=len(stopping), timeout=_LEAVE_S)
        for one in self._nodes.values():
            self._ray.kill(one.actor)
        self._nodes.clear()
        self._ray.shutdown()


def require_reachable(address: str | None) -> None:
    """Checks that a server accepts connections at the address of a cluster. Ray itself retries for minutes.

    Args:
        address: HOST:PORT, `ray://HOST:PORT`, `auto` or `local`; `None` starts a cluster on this host.

    Raises:
        UsageError: The address is not valid, or no connection can be opened.
    """
    if address is None or address in _NAMED_CLUSTERS:
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not (port.isascii() and port.isdecimal() and len(port) <= 5 and 0 < int(port) < 1 << 16):
        raise UsageError(f"{address!r} is not the address of a Ray cluster; example: 10.0.0.1:6379")
    if cause := why_unreachable((f"tcp/{host}:{port}",), None):
        raise UsageError(f"no Ray cluster at {address}: {cause}; start one with `ray start --head`")


def _contents(folder: Path) -> Mapping[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


@contextmanager
def open_cluster(address: str | None, cores: int | None, renderer: RendererKind) -> Iterator[RayCluster]:
    """Connects to a Ray cluster while the context is open. The authority and the certificates are in memory, in a
    folder that the next start removes if this process is killed."""
    remove_stale(Path(tempfile.gettempdir()))  # folders of older versions, and of workers on this machine
    with (
        Scratch(f"{PREFIX}{secrets.token_hex(6)}", memory_folder()) as keys,
        RayCluster(address, keys.path / "pki", cores, renderer) as cluster,
    ):
        yield cluster
