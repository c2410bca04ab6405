"""What a benchmark reports: spreads over runs, the machine they were taken on, and the work that was done.

Wall-clock seconds are what a user waits for; CPU seconds are those of the process with all its threads, llvmpipe's too.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Self

from schemas.base import Model

__all__ = [
    "CoordinatorBench",
    "Crowd",
    "Machine",
    "Memory",
    "MemoryBench",
    "PlainPace",
    "ReadBench",
    "RenderBench",
    "RolloutBench",
    "Rush",
    "SceneRender",
    "SceneRollout",
    "Spread",
    "StageCost",
    "WireBench",
]


class Spread(Model):
    """A figure over several runs."""

    median: float
    low: float
    high: float
    runs: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """Returns the spread of at least one value."""
        return cls(median=median(values), low=min(values), high=max(values), runs=len(values))


class Machine(Model):
    """Where the figures were taken; nothing in it names the machine's owner or place."""

    cpu: str
    cores: int
    """That this process may use."""
    memory_gib: float
    system: str
    python: str
    load_1m: float
    """Mean number of runnable processes over the last minute before the benchmark: above 0 the wall clock suffers."""


class StageCost(Model):
    """What one stage of the loop takes, milliseconds a frame."""

    stage: str
    wall_ms: Spread
    cpu_ms: Spread


class Memory(Model):
    """Resident memory of the process that simulates, MiB."""

    start_mib: float
    """After the first episode, when scene, shaders and buffers are there; `factory bench memory` has it from before."""
    end_mib: float
    """After the last episode."""
    peak_mib: float
    """The most it ever was."""


class PlainPace(Model):
    """The plain PyBullet pipeline on the same scene and poses."""

    frames: int
    frames_per_s: float
    """Wall clock."""
    frames_per_cpu_s: float
    stages: dict[str, float]
    """Milliseconds a frame, wall clock."""


class SceneRollout(Model):
    """The whole loop in one scene."""

    frames_per_s_per_core: float
    """Median over the repeats, wall clock, one simulation on one core; start-up of each episode included."""
    frames_per_cpu_s: float
    """The same by CPU time of the process, which other processes on the machine do not change."""
    wall: Spread
    """Frames per second of wall clock."""
    cpu: Spread
    """Frames per second of CPU time."""
    by_job: Spread
    """Frames per wall-clock second of single episodes of one repeat: how much hangs on what the robot looks at."""
    stages: tuple[StageCost, ...]
    delivery: tuple[StageCost, ...]
    """What the coordinator spends on a bundle, `validate` and `archive`; not in the figures above."""
    episodes: int
    """That succeeded, and were timed."""
    frames: int
    """In them, a repeat."""
    failed_attempts: int
    """Of the same jobs, a repeat; not in the figures above."""
    failed_share_of_time: float
    """Wall clock spent on failed attempts over that of all attempts."""
    kb_per_frame: dict[str, float]
    """Bytes stored a frame by kind of member, kB (1000 bytes)."""
    memory: Memory
    plain: PlainPace | None = None
    ratio: float | None = None
    """Wall-clock frames per second over those of the plain pipeline."""


class MemoryBench(Model):
    """`factory bench memory`."""

    bench: str = "memory"
    machine: Machine
    renderer: str
    scenes: tuple[str, ...]
    """That took turns."""
    episodes: int
    succeeded: int
    """Of the few that were not cut short."""
    frames: int
    """In all."""
    settled_mib: float
    """Median over the second tenth of the episodes: every scene has been shown, caches are full."""
    last_mib: float
    """Median over the last tenth; what it has over `settled_mib` is the growth."""
    memory: Memory


class RolloutBench(Model):
    """`factory bench rollout`."""

    bench: str = "rollout"
    machine: Machine
    renderer: str
    plan: str
    repeats: int
    scenes: dict[str, SceneRollout]


class SceneRender(Model):
    """Rendering alone, in one scene."""

    frames: int
    frames_per_s: Spread
    """All three images, wall clock."""
    stages: tuple[StageCost, ...]
    without_colour: tuple[StageCost, ...]
    """Depth and ids alone, as an expert sees them; the rest of `stages` is what colour costs."""
    triangles: int
    """In the scene."""
    triangles_in_view: float
    """A frame: of the parts whose box reaches into the view, hidden or not."""


class RenderBench(Model):
    """`factory bench render`."""

    bench: str = "render"
    machine: Machine
    renderer: str
    repeats: int
    scenes: dict[str, SceneRender]


class Crowd(Model):
    """Many workers connected at once, each with a lease."""

    sessions: int
    memory: Memory
    """Of the coordinator with all of them."""


class Rush(Model):
    """All workers finish a large bundle at the same moment, while somebody else goes on claiming."""

    workers: int
    bundle_mb: float
    """MB (1e6 bytes) each."""
    seconds: float
    """Until the last one was archived and dropped."""
    mb_per_s: float
    claims: int
    """Of the bystander meanwhile."""
    claim_p50_ms: float
    claim_p99_ms: float
    memory: Memory
    """Of the coordinator."""


class WireBench(Model):
    """A whole coordinator in a process of its own, asked over zenoh on loopback by processes beside it."""

    cycles_per_s: Spread
    """Claim and announcement of one job each, answered when durable; wall clock."""
    archived_per_s: Spread
    """Small bundles pulled and archived meanwhile; the others wait, as they would for a busy coordinator."""
    coordinator_cpu_ms: Spread
    """CPU time of the coordinator's process a cycle, pulling beside it included."""
    workers_cpu_ms: Spread
    """CPU time of the process of all workers a cycle, on the same cores."""
    start_s: Spread
    """Until it listens, on the filled ledger."""
    crowd: Crowd
    rush: Rush


class CoordinatorBench(Model):
    """`factory bench coordinator`."""

    bench: str = "coordinator"
    machine: Machine
    jobs: int
    """In the ledger."""
    workers: int
    """Requests in flight."""
    fill_s: float
    """Expanding the plan and writing its jobs."""
    cycles_per_s: Spread
    """Lease, announce and archive of one job each, durable on disk; wall clock."""
    reopen_s: Spread
    """Opening the filled ledger again and checking it against the plan."""
    progress_s: Spread
    """One look at the progress of the filled ledger."""
    validate_ms_per_frame: Spread
    """Of real bundles in the validating child, wall clock."""
    archive_mb_per_s: Spread
    """Copy, hash, fsync and rename of real bundles, wall clock."""
    memory: Memory
    wire: WireBench


class ReadBench(Model):
    """`factory bench read`."""

    bench: str = "read"
    machine: Machine
    episodes: int
    frames: int
    repeats: int
    random_frames_per_s: Spread
    """Colour, depth and ids of random frames of random episodes; one core, wall clock."""
    random_frames_per_cpu_s: Spread
    by_image: dict[str, Spread]
    """The same of one image alone."""
    open_ms: Spread
    """Opening an episode anew until its first array is there."""
    loader_workers: int
    loader_frames_per_s: Spread | None = None
    """Shuffled torch DataLoader over all frames, with worker processes; `None` without torch."""
    threads_frames_per_s: Spread | None = None
    """The same without worker processes: batches are decoded in threads on all cores."""
    memory: Memory
