"""Computes the tables of an evaluation: metrics with intervals, by split, scene, tier, category and template; faults.

Pure functions.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated

from pydantic import Field

from factory.eval.models.result import (
    BOUNDS,
    MEANS,
    RESULTS_FORMAT,
    EpisodeResult,
    EvalEnd,
    FailureKind,
    Latency,
    Variant,
)
from factory.eval.policies.registry import PolicyNote
from factory.eval.results.compare import PairedComparison
from factory.eval.results.estimate import NO_VALUES, IntervalEstimate, difference_of_shares, mcnemar_p, means_of
from factory.stats.measures import share_of
from factory.stats.statistics import Share
from schemas.base import Fraction, Model, Name, Positive, Sha256
from schemas.instruction.templates import TEMPLATES
from schemas.terms import CATEGORIES, Split, SuccessMeasure, Tier, family_of
from schemas.view import ViewSettings


class FaultCount(Model):
    """Episodes of a policy that ended with one kind of policy failure, under all instruction variants."""

    end: EvalEnd
    drives: Annotated[int, Field(ge=1)]
    of: Annotated[int, Field(ge=1)]
    """Number of episodes of the policy under all instruction variants."""
    first: Name
    """First episode with this failure."""
    detail: str
    """Message of that failure, with file and line if known."""


def faults_of(results: Sequence[EpisodeResult]) -> tuple[FaultCount, ...]:
    """Returns the kinds of failure of a policy, the most frequent first.

    Args:
        results: All results of the policy, in order.
    """
    rows: dict[EvalEnd, list[EpisodeResult]] = {}
    for row in results:
        if row.end.is_of_the_policy:
            rows.setdefault(row.end, []).append(row)
    faults = (
        FaultCount(
            end=end,
            drives=len(episodes_by_row),
            of=len(results),
            first=episodes_by_row[0].spec_id,
            detail=episodes_by_row[0].detail,
        )
        for end, episodes_by_row in rows.items()
    )
    return tuple(sorted(faults, key=lambda fault: (-fault.drives, fault.end)))


GROUPS: Mapping[str, str] = MappingProxyType(
    {
        "split": "By split",
        "view": "By categories in view at the start",
        "scene": "By scene",
        "tier": "By tier",
        "category": "By category",
        "template": "By template",
    }
)
"""Kind of group -> title of its table."""

NO_SHARE = Share(count=0, of=0, share=None, low=None, high=None)
ALL = "all"
GROUNDED = "two or more categories in view"


class Score(Model):
    """Metrics of one group of episodes."""

    by: str
    """Kind of group: `all`, `split`, `scene`, `tier`, `category`, `template` or `view`."""
    group: str
    n: Annotated[int, Field(ge=0)]
    success: Share
    """SR: share of episodes that stopped within the success radius of the target."""
    oracle_success: Share = NO_SHARE
    """Share of episodes in which the robot was within the success radius of the target at any time."""
    any_instance: Share
    """SR if every object of the target's category counts as the target."""
    collision: Share
    """Share of episodes that ended by the stall rule (paper Sec. VII)."""
    timeout: Share
    policy_failure: Share
    """Share of episodes in which the policy raised, hung, died or returned an invalid action."""
    contact: Share
    """Share of episodes with a contact other than the floor."""
    ne_m: IntervalEstimate
    """Mean NE by the success measure."""
    ne_centroid_m: IntervalEstimate = NO_VALUES
    ne_surface_m: IntervalEstimate = NO_VALUES
    """Mean NE to the footprint, over the episodes whose scene records footprints."""
    trajectory_length_m: IntervalEstimate
    spl: IntervalEstimate
    soft_spl: IntervalEstimate
    progress_final: IntervalEstimate
    progress_max: IntervalEstimate
    progress_normalised: IntervalEstimate
    num_steps: IntervalEstimate
    clipped: Fraction | None = None
    """Share of the actions that were outside the range of the robot and were clipped; `None` without actions."""


class Ablation(Model):
    """Effect of another instruction variant on the success rate, over the same episodes."""

    variant: Variant
    by: str
    """`all`, or `view` for the episodes with two or more categories in view."""
    n: Annotated[int, Field(ge=0)]
    """Number of pairs of episodes."""
    success: Share
    """SR with this variant."""
    gap: IntervalEstimate
    """SR with the original instruction minus SR with this variant, a fraction."""
    p: Fraction
    """p value of the exact McNemar test."""

    @property
    def difference(self) -> IntervalEstimate:
        """SR with this variant minus SR with the original instruction, as tables show it."""
        gap = self.gap
        if gap.mean is None or gap.low is None or gap.high is None:
            return gap
        return IntervalEstimate(n=gap.n, mean=-gap.mean, low=-gap.high, high=-gap.low)


class TrainingOverlap(Model):
    """Training episodes of a policy among the evaluated episodes."""

    train_digest: Sha256
    """Digest of the training episodes."""
    train_episodes: Annotated[int, Field(ge=1)]
    evaluation_digest: Sha256 | None
    """Digest of the archived episodes that the specs come from, by the same definition; `None` without any."""
    episodes: Annotated[int, Field(ge=0)]
    """Number of evaluated episodes."""
    trained_on: Annotated[int, Field(ge=0)] | None
    """How many of them the policy was trained on; `None` if it is not known."""


class PolicyScores(Model):
    """Tables of one policy."""

    policy: str
    reference: str = Field(default="", exclude_if=lambda it: not it)
    """What a policy with a separate name refers to; empty and omitted for other policies."""
    knows: str
    """Information used by the policy; models use camera, instruction and odometry only."""
    reads_instruction: bool
    """Whether the policy uses the instruction; otherwise the other variants are not run."""
    overall: Score
    groups: tuple[Score, ...]
    ends: dict[EvalEnd, int]
    failures: dict[FailureKind, Share] = Field(default={}, exclude_if=lambda it: not it)
    """Share of the episodes with each kind of failure that occurred, the most frequent first."""
    made_from: dict[str, str] = Field(default={}, max_length=1001, exclude_if=lambda it: not it)
    """SHA-256 of each file of the policy, or of its server's greeting."""
    training: TrainingOverlap | None = Field(default=None, exclude_if=lambda it: it is None)
    """Overlap of training and evaluation; `None` and omitted if the policy does not state its training."""
    faults: tuple[FaultCount, ...] = ()
    """Policy failures under all instruction variants."""
    ablation: tuple[Ablation, ...]
    act_ms: float | None
    """Mean inference time, milliseconds; not reproducible."""

    @property
    def described(self) -> str:
        """What the policy is, if its name does not say it, and its information."""
        return f"{self.reference}; input: {self.knows}" if self.reference else f"input: {self.knows}"

    @property
    def only_failed(self) -> bool:
        return 0 < self.overall.n == self.overall.policy_failure.count


class EvalLimits(Model):
    """Limits of the episodes and of the policies."""

    max_steps: Annotated[int, Field(ge=1)]
    """Step limit of an episode."""
    control_hz: Annotated[int, Field(ge=1)]
    act_timeout_s: Positive
    """Time limit of an answer, seconds."""
    load_timeout_s: Positive
    """Time limit of the creation of a policy, of a reset, and of the first answer, seconds."""

    def describe(self) -> str:
        return (
            f"{self.max_steps} steps ({self.max_steps / self.control_hz:.3g} s) for an episode; "
            f"{self.act_timeout_s:g} s for an answer; "
            f"{self.load_timeout_s:g} s for loading a policy, a reset and the first answer"
        )


class Evaluation(Model):
    """Content of `results.json`."""

    format: int = RESULTS_FORMAT
    run: str
    """Run name of the dataset."""
    source: str
    """Origin of the specs."""
    specs_digest: Sha256
    episodes: Annotated[int, Field(ge=0)]
    success: SuccessMeasure = SuccessMeasure.CENTROID
    """Measure of the distance to the target."""
    success_radius_m: float
    view: ViewSettings = Field(default=ViewSettings(), exclude_if=lambda view: view == ViewSettings())
    """View settings of the observations; omitted for the recorded camera."""
    limits: EvalLimits | None = Field(default=None, exclude_if=lambda it: it is None)
    """Limits of the evaluation; `None` in results of older versions."""
    latency: Latency | None = Field(default=None, exclude_if=lambda it: it is None)
    """Time that passes in the simulation for each answer of a policy; `None` and omitted if the simulation waits."""
    complete: bool
    """Whether every episode of every policy is finished."""
    policies: tuple[PolicyScores, ...]
    comparisons: tuple[PairedComparison, ...] = Field(default=(), exclude_if=lambda it: not it)
    """Comparisons of each pair of policies with the original instruction; omitted for one policy."""
    remarks: tuple[str, ...] = ()


def _pattern_group(template_id: str) -> str:
    """Returns the group of a template: a template of the paper is a group; others are grouped by language and register.

    The name of a group of other templates has the form `en_polite`.
    """
    return template_id if template_id in TEMPLATES else template_id.rpartition("_")[0] or template_id


_KEYS: Mapping[str, tuple[Callable[[EpisodeResult], str], Sequence[str]]] = MappingProxyType(
    {
        "split": (lambda row: str(row.split), [str(split) for split in Split]),
        "scene": (lambda row: family_of(row.scene), ()),
        "tier": (lambda row: str(row.tier), [str(tier) for tier in Tier]),
        "category": (lambda row: row.category, CATEGORIES),
        "template": (lambda row: _pattern_group(row.template_id), tuple(TEMPLATES)),
        "view": (lambda row: GROUNDED if row.is_grounded else "fewer", (GROUNDED, "fewer")),
    }
)
"""Kind of group -> function that returns the group of a row, and the groups that are listed first, in this order."""


def score_policy(policy: str, results: Sequence[EpisodeResult], note: PolicyNote) -> PolicyScores:
    """Returns all tables of a policy.

    Args:
        policy: Name of the policy.
        results: Finished episodes of the policy, all variants.
        note: Metadata of the policy.
    """
    original = [row for row in results if row.variant is Variant.ORIGINAL]
    # the measures of a policy that failed in every episode describe its faults, not the policy
    is_evaluated = not original or any(not row.end.is_of_the_policy for row in original)
    return PolicyScores(
        policy=policy,
        reference=note.reference,
        knows=note.knows,
        reads_instruction=note.reads_instruction,
        overall=score(ALL, ALL, original, is_evaluated),
        groups=tuple(_grouped(original, is_evaluated)),
        ends=dict(sorted(Counter(row.end for row in original).items())),
        failures=_failures(original),
        made_from=note.made_from,
        faults=faults_of(results),
        ablation=tuple(_ablations(results)) if is_evaluated else (),
        act_ms=sum(row.act_ms for row in original) / len(original) if original else None,
    )


def _failures(rows: Sequence[EpisodeResult]) -> dict[FailureKind, Share]:
    counts = Counter(row.failure for row in rows if row.failure is not None)
    order = list(FailureKind)
    ranked = sorted(counts.items(), key=lambda item: (-item[1], order.index(item[0])))
    return {kind: share_of(count, len(rows)) for kind, count in ranked}


def side_by_side(policies: Sequence[PolicyScores], by: str) -> Iterator[tuple[str, PolicyScores, Score]]:
    """Yields group name, policy and score for one kind of group, sorted by group, then by policy."""
    names = dict.fromkeys(group.group for policy in policies for group in policy.groups if group.by == by)
    for name in names:
        for policy in policies:
            for group in policy.groups:
                if (group.by, group.group) == (by, name):
                    yield name, policy, group


def score(by: str, group: str, drives: Sequence[EpisodeResult], has_measures: bool = True) -> Score:
    """Returns the metrics of a group of episodes.

    Args:
        by: Kind of group.
        group: Name of the group.
        drives: Results of the group.
        has_measures: Whether the policy was evaluated; otherwise only the policy failures are counted.
    """
    rows = drives if has_measures else ()
    means = means_of({name: [getattr(row, field) for row in rows] for name, field in MEANS.items()}, BOUNDS)
    steps = sum(row.num_steps for row in rows)
    return Score(
        by=by,
        group=group,
        n=len(drives),
        success=_share(rows, lambda row: row.success),
        oracle_success=_share(rows, lambda row: row.oracle_success),
        any_instance=_share(rows, lambda row: row.any_instance),
        collision=_share(rows, lambda row: row.end is EvalEnd.COLLISION),
        timeout=_share(rows, lambda row: row.end is EvalEnd.TIMEOUT),
        policy_failure=_share(drives, lambda row: row.end.is_of_the_policy),
        contact=_share(rows, lambda row: row.contact_steps > 0),
        clipped=min(1.0, sum(row.clipped_actions for row in rows) / steps) if steps else None,
        **means,
    )


def _share(rows: Sequence[EpisodeResult], holds: Callable[[EpisodeResult], bool]) -> Share:
    return share_of(sum(map(holds, rows)), len(rows))


def _grouped(rows: Sequence[EpisodeResult], has_measures: bool) -> Iterator[Score]:
    for by, (name_of, order) in _KEYS.items():
        groups: dict[str, list[EpisodeResult]] = {}
        for row in rows:
            groups.setdefault(name_of(row), []).append(row)
        for name in _ordered(groups, order):
            yield score(by, name, groups[name], has_measures)


def _ordered(names: Iterable[str], order: Sequence[str]) -> list[str]:
    place = {name: number for number, name in enumerate(order)}
    return sorted(names, key=lambda name: (place.get(name, len(place)), name))


def _ablations(results: Sequence[EpisodeResult]) -> Iterator[Ablation]:
    true = {row.spec_digest: row for row in results if row.variant is Variant.ORIGINAL}
    for variant in Variant:
        pairs = [(true[row.spec_digest], row) for row in results if row.variant is variant and row.spec_digest in true]
        if variant is Variant.ORIGINAL or not pairs:
            continue
        yield _ablation(variant, ALL, pairs)
        yield _ablation(variant, "view", [pair for pair in pairs if pair[0].is_grounded])


def _ablation(variant: Variant, by: str, pairs: Sequence[tuple[EpisodeResult, EpisodeResult]]) -> Ablation:
    only_true = sum(true.success and not other.success for true, other in pairs)
    only_other = sum(other.success and not true.success for true, other in pairs)
    return Ablation(
        variant=variant,
        by=by,
        n=len(pairs),
        success=share_of(sum(other.success for _, other in pairs), len(pairs)),
        gap=difference_of_shares(only_other, only_true, len(pairs)),
        p=mcnemar_p(only_true, only_other),
    )
