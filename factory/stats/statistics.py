"""Models of the statistics: one frozen model for each table row, used by the JSON output and the report.

Computes nothing.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from schemas.base import Fraction, Model, NonNegative
from schemas.terms import SuccessMeasure

Count = Annotated[int, Field(ge=0)]
Interval = tuple[float, float]
"""Lower and upper end of a 95 % interval."""


class Published(Model):
    """Values that the paper prints for one row; `None` where it prints none."""

    source: str
    """Table, figure or section of the paper."""
    n: Count | None = None
    ne_mean_m: float | None = None
    ne_std_m: float | None = None
    tl_mean_m: float | None = None
    tl_median_m: float | None = None
    steps_mean: float | None = None
    steps_median: float | None = None
    share: float | None = None
    """Share of all episodes."""
    rate: tuple[float, float] | None = None
    """Range of the share of attempts that succeeded: lower and upper end."""


class Remark(Model):
    """Remark about omitted or incomplete data, with the reason."""

    is_damage: bool
    """Whether the remark reports inconsistent data; false for data that are only incomplete."""
    file: str
    text: str


class RolloutRow(Model):
    """Rollout statistics of a group of episodes (paper Tables V-VII); means and medians are `None` without episodes."""

    group: str
    n: Count
    share: Fraction | None
    """Share of all episodes."""
    ne_mean_m: float | None
    tl_mean_m: float | None
    tl_median_m: float | None
    steps_mean: float | None
    steps_median: float | None
    ne_interval_m: Interval | None = None
    """95 % interval of the mean NE, metres. The three intervals are Student's t; `None` for fewer than two episodes."""
    tl_interval_m: Interval | None = None
    """95 % interval of the mean TL, metres."""
    steps_interval: Interval | None = None
    """95 % interval of the mean number of steps."""
    paper: Published | None = None


class CountRow(Model):
    """Frequency of a category or a template."""

    group: str
    kind: str
    """`seen` or `held out` for a category; the template pool for a template."""
    n: Count
    share: Fraction | None
    """Share of all episodes."""
    paper: Published | None = None


class Share(Model):
    """Proportion with its 95 % Wilson interval."""

    count: Count
    of: Count
    share: Fraction | None
    low: Fraction | None
    high: Fraction | None


class AttemptRow(Model):
    """Results of the attempts of a group.

    Attempts are runs that ended with success, collision or another failure of the task; lost leases and crashes do not
    count.
    """

    group: str
    attempts: Count
    success: Share
    first: Share
    """Share of first attempts that succeeded; the gate of `factory run` measures the same share."""
    collision: Share
    timeout: Share
    reasons: dict[str, int]
    """Failures by reason, including failures of a worker or the transport, which do not count as `attempts`."""
    paper: Published | None = None


class CellRow(Model):
    """Cell of the plan: its quota, and the attempts needed to fill it."""

    scene: str
    split: str
    tier: str
    planned: Count
    archived: Count
    attempts: Count | None
    """Attempts that ended with success or a failure of the task; `None` when the table of attempts is unreadable."""


class ErrorRow(Model):
    """Quantiles of the navigation error (NE) of a group, metres."""

    group: str
    n: Count
    mean: float | None
    std: float | None
    """Sample standard deviation, metres; `None` for fewer than two episodes."""
    interval: Interval | None = None
    """95 % interval of the mean (Student's t), metres; `None` for fewer than two episodes."""
    quantiles: dict[str, float]
    """Quantiles `p00` (minimum) to `p100` (maximum), metres; empty without episodes."""
    within_radius: Share
    """Share of episodes that ended within the success radius."""
    paper: Published | None = None


class Fit(Model):
    """Pearson correlation of spawn distance and trajectory length, and the least-squares line."""

    group: str
    n: Count
    r: float | None
    low: float | None
    """Lower end of the 95 % interval of r (Fisher's z)."""
    high: float | None
    p: NonNegative | None
    """Two-sided p value of the hypothesis of no correlation."""
    slope: float | None
    """Slope of the line: metres of trajectory per metre of spawn distance."""
    slope_error: float | None
    """Standard error of the slope."""
    intercept_m: float | None
    remark: str = ""
    """Reason why the values are `None`; empty otherwise."""


class FarRow(Model):
    """Distances along the floor from the far starts of a scene to the target.

    A distance is the shortest path to the success region plus the success radius.
    """

    scene: str
    n: Count
    """Number of far starts that have a path along the floor."""
    mean_m: float | None
    interval_m: Interval | None
    """95 % interval of the mean (Student's t), metres."""
    least_m: float = 5.0
    """Smallest distance along the floor that the plan permits, metres."""
    short: Share
    """Share of starts less than `least_m` from the target along the floor."""
    corner: Share
    """Share of starts without a free straight line to the success region: the path has a corner."""


class OverlapRow(Model):
    """Overlap of the target instances of a split with those of `train_id`."""

    scene: str
    split: str
    targets: Count
    """Number of distinct target instances in the split."""
    shared: Count
    """Number of those instances that also occur in training."""
    share: Fraction | None
    episodes: Count
    episodes_on_shared: Count
    """Episodes of the split whose target instance also occurs in training."""


class Statistics(Model):
    """All statistics tables of a dataset."""

    dataset: str
    run: str
    expert: str
    episodes: Count
    """Number of episodes that the tables are computed from."""
    planned: Count
    complete: bool
    success: SuccessMeasure = SuccessMeasure.CENTROID
    """Measure of the distance to the target, used for all start distances and errors except `other_error`."""
    success_radius_m: float
    beside_paper: bool = True
    """Whether the rows include values of the paper."""
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
    """Rows by scene, by tier, by scene and tier, and for all; `None` when the table of attempts is unreadable."""
    cells: tuple[CellRow, ...]
    navigation_error: tuple[ErrorRow, ...]
    other_error: tuple[ErrorRow, ...] = ()
    """Navigation errors by the other success measure; empty if no episode records it."""
    correlation: tuple[Fit, ...]
    overlap: tuple[OverlapRow, ...]
    far: tuple[FarRow, ...] = ()
    """Far starts of each scene and of all scenes."""

    @property
    def is_sound(self) -> bool:
        """Returns whether no data were omitted because of damage."""
        return not any(remark.is_damage for remark in self.remarks)


class LanguageRow(Model):
    """Shares of episodes in which the target can be found without language, or the instruction is not clear.

    The comment of each `Share` states what is true in the counted episodes. If targets are drawn at the start, only
    the objects that could be the target count as objects of the category.
    """

    group: str
    """Name of the scene, or `all`."""
    n: Count
    nearest: Share
    """The nearest object in view at the start is the target."""
    central: Share
    """The object in view with the smallest bearing at the start is the target."""
    central_of_category: Share
    """The object of the named category in view with the smallest bearing at the start is the target."""
    nearest_of_category: Share
    """The nearest object of the named category in view at the start is the target."""
    largest_of_category: Share
    """The object of the named category in view with the largest mask at the start is the target."""
    chance: float | None
    """Expected share of episodes in which a random choice among the objects of the named category in view at the start
    is the target."""
    others_in_view: float | None
    """Mean number of other objects of the named category in view at the start."""
    several_in_scene: Share
    """The instruction fits several objects of the scene."""
    several_in_view: Share
    """The instruction fits several objects in view at the start."""
    contradictory: Share
    """The target is not in view at the start, but another object of its category is."""
    not_in_front: Share
    """The target is not in view, or is more than 30 degrees from the heading. This is a share of the episodes with
    `in front of you` in the instruction."""


class ArrivalRow(Model):
    """Share of the episodes of a category whose target is in view in the last frame."""

    group: str
    """Name of the category, or `all`."""
    in_view: Share


class WordingRow(Model):
    """Variety of the instructions of a language."""

    language: str
    """Code of the language."""
    n: Count
    """Number of instructions."""
    distinct: Count
    """Number of different instructions."""
    vocabulary: Count
    """Number of different words, or of characters in Chinese."""
    words_mean: float | None
    """Mean length, words."""
    words_least: Count
    """Smallest length, words."""
    words_most: Count
    """Largest length, words."""
    self_bleu: float | None
    """Mean BLEU-4 of each instruction with all others as references; small if the instructions vary."""


class FeatureRow(Model):
    """Share of the verified instructions with a feature, such as `ordinal`, beside what the plan asks."""

    feature: str
    """Name of the feature."""
    asked: float | None
    """Weight in the plan as a share of all weights, 0..1; `None` if the plan does not ask for verified instructions."""
    largest: float | None
    """Largest share that the plan permits, 0..1; `None` without a limit."""
    realised: Share
    """Share of the instructions with the feature; an instruction may have several."""


class PatternRow(Model):
    """Share of the instructions with a sentence pattern or a template."""

    pattern: str
    """Name of the pattern or the template."""
    realised: Share


class LanguageStatistics(Model):
    """Statistics of instructions and of the objects in view at the start and at the end."""

    dataset: str
    run: str
    episodes: Count
    """Number of episodes of the dataset."""
    read: Count
    """Number of episodes whose first and last frames were read."""
    instructions: Count
    """Number of distinct instructions in the episodes read."""
    remarks: tuple[Remark, ...]
    rows: tuple[LanguageRow, ...]
    """One row for each scene, and one for all scenes."""
    arrivals: tuple[ArrivalRow, ...]
    """One row for each category, most frequent first, and one for all categories."""
    wording: tuple[WordingRow, ...]
    """One row for each language, most frequent first."""
    unique: Share
    """Share of instructions that fit exactly one object of the scene."""
    others_in_scene: float | None
    """Mean number of other objects of the named category in the scene."""
    false_premises: Count
    """Number of instructions that fit no object; the other measures exclude them."""
    features: tuple[FeatureRow, ...] = ()
    """One row for each feature that the plan asks for or the instructions have, most frequent first."""
    patterns: tuple[PatternRow, ...] = ()
    """One row for each sentence pattern or template, most frequent first."""

    @property
    def is_sound(self) -> bool:
        """Returns whether no data were omitted because of damage."""
        return not any(remark.is_damage for remark in self.remarks)
