"""What statistics consist of: frozen models, one a row of a table, that JSON and the report share. Values only."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.base import Fraction, Model, NonNegative

__all__ = [
    "AttemptRow",
    "CellRow",
    "CountRow",
    "ErrorRow",
    "Fit",
    "OverlapRow",
    "Published",
    "Remark",
    "RolloutRow",
    "Share",
    "Statistics",
]

Count = Annotated[int, Field(ge=0)]


class Published(Model):
    """What the paper prints for one row; `None` where it prints nothing."""

    source: str
    """Table, figure or section."""
    n: Count | None = None
    ne_mean_m: float | None = None
    ne_std_m: float | None = None
    tl_mean_m: float | None = None
    tl_median_m: float | None = None
    steps_mean: float | None = None
    steps_median: float | None = None
    share: float | None = None
    """Of all episodes."""
    rate: tuple[float, float] | None = None
    """Attempt-to-success rate, from and to."""


class Remark(Model):
    """Something that is left out or incomplete, and why."""

    is_damage: bool
    """Whether the dataset contradicts itself, rather than being unfinished or small."""
    file: str
    text: str


class RolloutRow(Model):
    """Rollout statistics of a group of episodes (paper Tables V-VII); means and medians are `None` without episodes."""

    group: str
    n: Count
    share: Fraction | None
    """Of all episodes."""
    ne_mean_m: float | None
    tl_mean_m: float | None
    tl_median_m: float | None
    steps_mean: float | None
    steps_median: float | None
    paper: Published | None = None


class CountRow(Model):
    """How often a category or a template occurs."""

    group: str
    kind: str
    """Of a category `seen` or `held out`; of a template its pool."""
    n: Count
    share: Fraction | None
    """Of all episodes."""
    paper: Published | None = None


class Share(Model):
    """A proportion with its 95 % Wilson interval."""

    count: Count
    of: Count
    share: Fraction | None
    low: Fraction | None
    high: Fraction | None


class AttemptRow(Model):
    """What became of the attempts of a group. Attempts are those the world decided; lost leases and crashes are not."""

    group: str
    attempts: Count
    success: Share
    first: Share
    """First attempts of an episode that succeeded, as the gate measures it."""
    collision: Share
    timeout: Share
    reasons: dict[str, int]
    """Failed attempts by reason; those of worker or transport, which count as no attempt, too."""
    paper: Published | None = None


class CellRow(Model):
    """A cell of the plan: its quota and what it took to fill it."""

    scene: str
    split: str
    tier: str
    planned: Count
    archived: Count
    attempts: Count | None
    """That the world decided, failed ones included; `None` when the record of attempts cannot be read."""


class ErrorRow(Model):
    """Quantiles of the navigation error of a group, metres."""

    group: str
    n: Count
    mean: float | None
    std: float | None
    """Sample standard deviation; `None` for fewer than two episodes."""
    quantiles: dict[str, float]
    """`p00` (smallest) to `p100` (largest); empty without episodes."""
    within_radius: Share
    """Episodes that ended inside the success radius."""
    paper: Published | None = None


class Fit(Model):
    """Pearson correlation of spawn distance and trajectory length, and the line through them."""

    group: str
    n: Count
    r: float | None
    low: float | None
    """Lower end of the 95 % interval of r (Fisher z)."""
    high: float | None
    p: NonNegative | None
    """Two-sided, of no correlation."""
    slope: float | None
    """Metres of trajectory per metre of spawn distance, by least squares."""
    slope_error: float | None
    """Standard error of the slope."""
    intercept_m: float | None
    remark: str = ""
    """Why there are no numbers, when there are none."""


class OverlapRow(Model):
    """How many named instances of a split also occur in `train_id`."""

    scene: str
    split: str
    targets: Count
    """Different instances that the split names."""
    shared: Count
    """Of those, the ones that training names too."""
    share: Fraction | None
    episodes: Count
    episodes_on_shared: Count
    """Episodes of the split whose instance training names too."""


class Statistics(Model):
    """Every table of a dataset."""

    dataset: str
    run: str
    expert: str
    episodes: Count
    """That the tables below rest on."""
    planned: Count
    complete: bool
    success_radius_m: float
    beside_paper: bool = True
    """Whether the rows below have the paper's values beside them."""
    remarks: tuple[Remark, ...]
    scenes: tuple[RolloutRow, ...]
    splits: tuple[RolloutRow, ...]
    tiers: tuple[RolloutRow, ...]
    scene_tiers: tuple[RolloutRow, ...]
    categories: tuple[CountRow, ...]
    three_largest_share: Fraction | None
    """Share of the three most frequent categories."""
    templates: tuple[CountRow, ...]
    attempts: tuple[AttemptRow, ...] | None
    """By scene, tier and both; `None` when the record of attempts cannot be read."""
    cells: tuple[CellRow, ...]
    navigation_error: tuple[ErrorRow, ...]
    correlation: tuple[Fit, ...]
    overlap: tuple[OverlapRow, ...]

    @property
    def is_sound(self) -> bool:
        """Whether nothing was left out for damage."""
        return not any(remark.is_damage for remark in self.remarks)
