"""Models of the results of `factory bench delivery` and `factory bench sessions`. Measures nothing."""

from __future__ import annotations

from typing import NamedTuple, Self

from coordinator.settings import CoordinatorSettings
from factory.bench.model import Machine
from schemas.base import Model
from schemas.terms import Recording


class DeliveryCost(NamedTuple):
    """Measurement of one variant."""

    seconds: float
    """Wall time, seconds."""
    cpu_s: float
    """CPU time of the coordinator and its validating processes, seconds."""
    unchecked: int
    """Number of archived episodes whose frames only their worker has validated."""


class DeliveryPace(Model):
    """Pace of a coordinator that archives valid bundles; CPU times include its validating processes."""

    pullers: int
    """Number of bundles that are transferred and validated at the same time."""
    spot_checks: float | None
    """Share of the bundles validated by workers that the coordinator validates completely again. `None`: the
    coordinator validates all bundles."""
    validated: int
    """Number of episodes that the coordinator validated completely."""
    seconds: float
    """Wall time, seconds; the simulated workers use the same cores."""
    cpu_s: float
    """CPU time of the coordinator, seconds."""
    frames_per_s: float
    """Archived frames per second of wall time."""
    frames_per_cpu_s: float
    """Archived frames per second of CPU time."""
    episodes_per_s: float
    """Archived episodes per second of wall time."""
    episodes_per_cpu_s: float
    """Archived episodes per second of CPU time."""

    @classmethod
    def of(cls, settings: CoordinatorSettings, frames: int, episodes: int, cost: DeliveryCost) -> Self:
        """Returns the pace of a variant from its measurement and the number of archived frames and episodes."""
        seconds, cpu_s, unchecked = cost
        return cls(
            pullers=settings.pullers,
            spot_checks=settings.spot_checks,
            validated=episodes - unchecked,
            seconds=seconds,
            cpu_s=cpu_s,
            frames_per_s=frames / seconds,
            frames_per_cpu_s=frames / cpu_s,
            episodes_per_s=episodes / seconds,
            episodes_per_cpu_s=episodes / cpu_s,
        )


class DeliveryBench(Model):
    """Result of `factory bench delivery`."""

    bench: str = "delivery"
    machine: Machine
    record: Recording
    episodes: int
    """Number of archived episodes of each variant."""
    frames: int
    """Number of steps of these episodes."""
    mb_per_episode: float
    """Mean size of a bundle, MB (1e6 bytes)."""
    workers: int
    """Number of simulated workers."""
    paces: tuple[DeliveryPace, ...]
    """Pace of each variant; the variants differ in the share of spot checks."""


class VerbLoad(Model):
    """Requests of one verb."""

    per_s: float
    """Requests per second of simulated time."""
    received_bytes: float
    """Mean size of a request, bytes."""
    sent_bytes: float
    """Mean size of a reply, bytes."""
    cpu_us: float
    """Mean CPU time of a request for parsing, ledger and reply, without commit and network, microseconds."""


class SessionsBench(Model):
    """Result of `factory bench sessions`."""

    bench: str = "sessions"
    machine: Machine
    sessions: int
    """Number of workers, each with one session."""
    cores: int
    """Number of simulations of each worker."""
    episode_s: float
    """Mean duration of an attempt, seconds."""
    lease_s: float
    """Lease time, seconds."""
    seconds: float
    """Simulated time, seconds."""
    verbs: dict[str, VerbLoad]
    """Verb -> load. The entry `archive` is not a request: it is the ledger's work to record an archived episode."""
    episodes_per_s: float
    """Archived episodes per second of simulated time."""
    commits_per_s: float
    """Commits of the ledger per second of simulated time; each is one fsync."""
    commit_us: float
    """CPU time of a commit, microseconds."""
    ledger_bytes_per_episode: float
    """Growth of the ledger per archived episode, bytes."""
    coordinator_cores: float
    """CPU time per second of simulated time, without network and bundles."""
