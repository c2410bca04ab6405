"""Models of benchmark results: spreads over runs, the machine, and the workload. Measures nothing.

Wall times are those that a user observes; CPU times are those of the process with all its threads, including llvmpipe.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Self

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
