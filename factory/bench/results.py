"""Models of benchmark results: spreads over runs, machine, workload, delivery and sessions. Measures nothing.

Wall times are those that a user observes; CPU times are those of the process with all its threads, including llvmpipe.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import NamedTuple, Self

from coordinator.settings import CoordinatorSettings
from schemas.base import Model
from schemas.terms import ExpertName, Recording


class Spread(Model):
    """Median and range of a value over several runs."""

    median: float
    low: float
    high: float
    runs: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Self:
        """Returns the spread of one or more values."""
        return cls(median=median(values), low=min(values), high=max(values), runs=len(values))


class Machine(Model):
    """Description of the machine that ran a benchmark, without host name or location."""

    cpu: str
    cores: int
    """Number of CPU cores available to this process."""
    memory_gib: float
    system: str
    python: str
    load_1m: float
    """Load average of the last minute before the benchmark; load of other processes increases the wall times."""


class StageCost(Model):
    """Cost of one stage of the loop, milliseconds per frame."""

    stage: str
    wall_ms: Spread
    cpu_ms: Spread


class Memory(Model):
    """Resident memory of a process, MiB."""

    start_mib: float
    """Memory before the measured work, MiB. `factory bench rollout` measures it after the warm-up episode, when scene,
    shaders and buffers are loaded; `factory bench memory` measures it before the first episode."""
    end_mib: float
    """Memory at the end of the measured work, MiB."""
    peak_mib: float
    """Peak memory, MiB."""


class PlainPace(Model):
    """Result of the plain PyBullet pipeline on the same scene and poses."""

    frames: int
    frames_per_s: float
    """Frames per second of wall time."""
    frames_per_cpu_s: float
    stages: dict[str, float]
    """Stage -> wall time per frame, milliseconds."""


class SceneRollout(Model):
    """Result of the complete loop in one scene."""

    frames_per_s_per_core: float
    """Median of `wall`: frames per second of one simulation on one core. Includes the start of each episode."""
    frames_per_cpu_s: float
    """Median of `cpu`, which other processes on the machine do not affect."""
    wall: Spread
    """Frames per second of wall time."""
    cpu: Spread
    """Frames per second of CPU time."""
    by_job: Spread
    """Frames per second of wall time of the successful episodes in the first repetition. Their views differ, so the
    range shows the influence of the view."""
    stages: tuple[StageCost, ...]
    delivery: tuple[StageCost, ...]
    """Cost of `validate` and `archive` in the coordinator; not included in the values above."""
    episodes: int
    """Number of successful episodes in each repetition."""
    frames: int
    """Number of frames of the successful episodes in each repetition."""
    failed_attempts: int
    """Number of failed attempts in each repetition; not included in the values above."""
    failed_share_of_time: float
    """Wall time of failed attempts as a share of the wall time of all attempts."""
    kb_per_frame: dict[str, float]
    """Stored size per frame by kind of member, kB (1000 bytes)."""
    memory: Memory
    plain: PlainPace | None = None
    ratio: float | None = None
    """Frames per second of wall time, divided by those of the plain pipeline."""


class CollectPace(Model):
    """Episode rate and CPU time of complete runs of one plan."""

    record: Recording
    expert: ExpertName
    episodes: int
    """Number of archived episodes of each run."""
    attempts: int
    """Number of attempts in the first run, including failed attempts."""
    episodes_per_hour: Spread
    """Archived episodes per hour of wall time, start and end of the run included."""
    cpu_s_per_episode: Spread
    """CPU time of all processes of the run per archived episode, seconds."""


class CollectBench(Model):
    """Result of `factory bench collect`."""

    bench: str = "collect"
    machine: Machine
    plan: str
    screening: str
    """Rule by which the plan selects start poses, see `Plan.screening`."""
    workers: int
    """Number of simulation processes."""
    repeats: int
    variants: dict[str, CollectPace]
    """Recording and expert, such as `states, planner` -> pace."""


class MemoryBench(Model):
    """Result of `factory bench memory`."""

    bench: str = "memory"
    machine: Machine
    renderer: str
    scenes: tuple[str, ...]
    """Names of the scenes, in the order of execution."""
    episodes: int
    succeeded: int
    """Number of successful episodes. Most episodes have a short step limit and end before they can succeed."""
    frames: int
    """Total number of frames."""
    settled_mib: float
    """Median memory over the second tenth of the episodes, MiB; by then all scenes are loaded and caches are full."""
    last_mib: float
    """Median memory over the last tenth, MiB; the difference to `settled_mib` is the growth."""
    memory: Memory


class RolloutBench(Model):
    """Result of `factory bench rollout`."""

    bench: str = "rollout"
    machine: Machine
    renderer: str
    plan: str
    screening: str
    """Rule by which the plan selects start poses, see `Plan.screening`."""
    repeats: int
    scenes: dict[str, SceneRollout]


class SceneRender(Model):
    """Result of rendering without simulation in one scene."""

    frames: int
    frames_per_s: Spread
    """Frames per second of wall time; a frame has three images: colour, depth and ids."""
    stages: tuple[StageCost, ...]
    without_colour: tuple[StageCost, ...]
    """Cost of rendering only depth and ids, which an expert uses. Empty if the size is not 640 pixels, or with
    antialiasing."""
    triangles: int
    """Number of triangles in the scene."""
    triangles_in_view: float
    """Mean number of triangles per frame of the scene parts whose bounding box intersects the view. Occluded parts are
    included."""


class RenderBench(Model):
    """Result of `factory bench render`."""

    bench: str = "render"
    machine: Machine
    renderer: str
    size: int
    """Width and height of the frames, pixels."""
    antialias: int
    """Samples per pixel along each axis."""
    repeats: int
    scenes: dict[str, SceneRender]


class SessionLoad(Model):
    """Result of many simultaneous worker sessions."""

    sessions: int
    memory: Memory
    """Memory of the coordinator with all sessions."""


class DeliveryLoad(Model):
    """Result of simultaneous deliveries: all workers finish a large bundle, while another worker claims jobs."""

    workers: int
    bundle_mb: float
    """Size of each bundle, MB (1e6 bytes)."""
    seconds: float
    """Wall time until the last bundle was archived and deleted, seconds."""
    mb_per_s: float
    claims: int
    """Number of claims that the other worker sent during the deliveries."""
    claim_p50_ms: float
    claim_p99_ms: float
    memory: Memory
    """Memory of the coordinator."""


class WireBench(Model):
    """Result for a complete coordinator in a separate process, with worker processes over zenoh on loopback."""

    cycles_per_s: Spread
    """Cycles of claim and announcement per second of wall time. The coordinator replies when a change is durable."""
    archived_per_s: Spread
    """Small bundles that the coordinator pulls and archives per second while the workers claim and announce."""
    coordinator_cpu_ms: Spread
    """CPU time of the coordinator process per cycle, including the concurrent pulling, milliseconds."""
    workers_cpu_ms: Spread
    """CPU time of the worker process per cycle, milliseconds. The process shares the cores with the coordinator."""
    start_s: Spread
    """Time from the start of the coordinator with a filled ledger until it listens, seconds."""
    session_load: SessionLoad
    delivery_load: DeliveryLoad


class CoordinatorBench(Model):
    """Result of `factory bench coordinator`."""

    bench: str = "coordinator"
    machine: Machine
    jobs: int
    """Number of jobs in the ledger."""
    workers: int
    """Number of concurrent requests."""
    fill_s: float
    """Time to expand the plan and write its jobs, seconds."""
    cycles_per_s: Spread
    """Cycles of lease, announcement and archive per second of wall time, durable on disk."""
    reopen_s: Spread
    """Time to reopen the filled ledger and compare it with the plan, seconds."""
    progress_s: Spread
    """Time to read the progress of the filled ledger, seconds."""
    validate_ms_per_frame: Spread
    """Wall time to validate real bundles in the validation process, milliseconds per frame."""
    pullers: int
    """Number of validating processes that work at the same time."""
    validated_frames_per_s: Spread
    """Frames of real bundles per second of wall time, summed over the `pullers` validating processes."""
    archive_mb_per_s: Spread
    """Throughput of copy, hash, fsync and rename of real bundles, MB per second of wall time."""
    memory: Memory
    wire: WireBench


class ReadBench(Model):
    """Result of `factory bench read`."""

    bench: str = "read"
    machine: Machine
    episodes: int
    frames: int
    repeats: int
    size: int
    """Width and height of the frames, pixels."""
    antialias: int
    """Samples per pixel along each axis."""
    random_frames_per_s: Spread
    """Random frames of random episodes (colour, depth and ids) per second of wall time, on one core."""
    random_frames_per_cpu_s: Spread | None
    """The same frames per second of CPU time of this process. `None` if another process renders the frames."""
    by_image: dict[str, Spread]
    """Kind of image -> random single images per second of wall time. Empty if the size is not 640 pixels, or with
    antialiasing."""
    open_ms: Spread
    """Time to open an episode and read its first array, milliseconds."""
    loader_workers: int
    one_thread_frames_per_s: Spread | None = None
    """Frames per second of a shuffled DataLoader that reads in one thread; `None` without torch."""
    loader_frames_per_s: Spread | None = None
    """Frames per second of a shuffled DataLoader with worker processes; `None` without torch."""
    threads_frames_per_s: Spread | None = None
    """Frames per second of a shuffled DataLoader that decodes in threads on all cores; `None` without torch."""
    memory: Memory


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
