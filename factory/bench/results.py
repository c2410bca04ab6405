"""Models of benchmark results: machine, spreads over runs, memory, and one model for each benchmark. Measures nothing.

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
    shaders and buffers are loaded."""
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
