"""The tables of an evaluation: every measure with its interval, by split, scene, tier, category and template. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Annotated

from pydantic import Field

from factory.eval.models.result import RESULTS_FORMAT, EpisodeResult, EvalEnd, Variant
from factory.eval.policies.note import PolicyNote
from factory.eval.results.estimate import IntervalEstimate, mcnemar_p, means_of
from factory.eval.results.faults import FaultCount, faults_of
from factory.stats.measures import share_of
from factory.stats.model import Share
from schemas.base import Fraction, Model, Sha256
from schemas.language import TEMPLATES
from schemas.terms import CATEGORIES, Split, Tier

__all__ = ["GROUPS", "MEANS", "Ablation", "Evaluation", "PolicyScores", "Score", "score_policy", "side_by_side"]

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
"""How episodes are grouped, and the title of that table."""

MEANS: Mapping[str, str] = MappingProxyType(
    {
        "ne_m": "final_ne_m",
        "trajectory_length_m": "trajectory_length_m",
        "spl": "spl",
        "soft_spl": "soft_spl",
        "progress_final": "progress_final",
        "progress_max": "progress_max",
        "progress_normalised": "progress_normalised",
        "num_steps": "num_steps",
    }
)
"""Field of a score -> field of the results that it is the mean of."""
ALL = "all"
GROUNDED = "two or more categories in view"


class Score(Model):
    """All measures of one group of episodes."""

    by: str
    """What the groups are: `all`, `split`, `scene`, `tier`, `category`, `template` or `view`."""
    group: str
    n: Annotated[int, Field(ge=0)]
    success: Share
    """SR: stopped within the radius of the target."""
    any_instance: Share
    """The same, at the target or any other object of its category."""
    collision: Share
    """Ended by the stall rule (paper Sec. VII)."""
    timeout: Share
    policy_failure: Share
    """Ended because the policy raised, hung, died or gave no action."""
    contact: Share
    """Touched anything but the floor."""
    ne_m: IntervalEstimate
    trajectory_length_m: IntervalEstimate
    spl: IntervalEstimate
    soft_spl: IntervalEstimate
    progress_final: IntervalEstimate
    progress_max: IntervalEstimate
    progress_normalised: IntervalEstimate
    num_steps: IntervalEstimate


class Ablation(Model):
    """What other words do to the success rate, over the same episodes."""

    variant: Variant
    by: str
    """`all`, or `view` for the episodes with two or more categories in view."""
    n: Annotated[int, Field(ge=0)]
    """Pairs of episodes."""
    success: Share
    """Under these words."""
    gap: IntervalEstimate
    """Success under the true words minus that under these."""
    p: Fraction
    """Of the exact McNemar test."""


class PolicyScores(Model):
    """One policy's tables."""

    policy: str
    knows: str
    """What it goes by; anything but camera and instruction is more than a model has."""
    reads_instruction: bool
    """If not, other words change nothing by construction, and are not tried."""
    overall: Score
    groups: tuple[Score, ...]
    ends: dict[EvalEnd, int]
    faults: tuple[FaultCount, ...] = ()
    """Where it failed as a program, under whatever words."""
    ablation: tuple[Ablation, ...]
    act_ms: float | None
    """Mean time of an answer, milliseconds; not part of the numbers that repeat."""

    @property
    def only_failed(self) -> bool:
        """Whether it failed as a program in every episode, so that nothing was measured but that."""
        return 0 < self.overall.n == self.overall.policy_failure.count


class Evaluation(Model):
    """The whole of `results.json`."""

    format: int = RESULTS_FORMAT
    run: str
    """Name of the run whose dataset it is."""
    source: str
    """Where the specs come from."""
    specs_digest: Sha256
    episodes: Annotated[int, Field(ge=0)]
    success_radius_m: float
    complete: bool
    """Whether every episode of every policy is over."""
    policies: tuple[PolicyScores, ...]
    remarks: tuple[str, ...] = ()


_KEYS: Mapping[str, tuple[Callable[[EpisodeResult], str], Sequence[str]]] = MappingProxyType(
    {
        "split": (lambda row: str(row.split), [str(split) for split in Split]),
        "scene": (lambda row: row.scene, ()),
        "tier": (lambda row: str(row.tier), [str(tier) for tier in Tier]),
        "category": (lambda row: row.category, CATEGORIES),
        "template": (lambda row: row.template_id, tuple(TEMPLATES)),
        "view": (lambda row: GROUNDED if row.is_grounded else "fewer", (GROUNDED, "fewer")),
    }
)
"""Kind of group -> how a row is named, and the order of the names; names beyond it follow sorted."""


def score_policy(policy: str, results: Sequence[EpisodeResult], note: PolicyNote) -> PolicyScores:
    """Returns all tables of a policy.

    Args:
        policy: its name.
        results: its finished episodes, all variants.
        note: what is known of it.
    """
    original = [row for row in results if row.variant is Variant.ORIGINAL]
    return PolicyScores(
        policy=policy,
        knows=note.knows,
        reads_instruction=note.reads_instruction,
        overall=score(ALL, ALL, original),
        groups=tuple(_grouped(original)),
        ends=dict(sorted(Counter(row.end for row in original).items())),
        faults=faults_of(results),
        ablation=tuple(_ablations(results)),
        act_ms=sum(row.act_ms for row in original) / len(original) if original else None,
    )


def side_by_side(policies: Sequence[PolicyScores], by: str) -> Iterator[tuple[str, PolicyScores, Score]]:
    """Yields group, policy and score of one kind of group: all policies of a group, then the next group."""
    names = dict.fromkeys(group.group for policy in policies for group in policy.groups if group.by == by)
    for name in names:
        for policy in policies:
            for group in policy.groups:
                if (group.by, group.group) == (by, name):
                    yield name, policy, group


def score(by: str, group: str, rows: Sequence[EpisodeResult]) -> Score:
    """Returns the measures of some episodes."""
    means = means_of({name: [getattr(row, field) for row in rows] for name, field in MEANS.items()})
    return Score(
        by=by,
        group=group,
        n=len(rows),
        success=_share(rows, lambda row: row.success),
        any_instance=_share(rows, lambda row: row.any_instance),
        collision=_share(rows, lambda row: row.end is EvalEnd.COLLISION),
        timeout=_share(rows, lambda row: row.end is EvalEnd.TIMEOUT),
        policy_failure=_share(rows, lambda row: row.end.is_of_the_policy),
        contact=_share(rows, lambda row: row.contact_steps > 0),
        **means,
    )


def _share(rows: Sequence[EpisodeResult], holds: Callable[[EpisodeResult], bool]) -> Share:
    return share_of(sum(map(holds, rows)), len(rows))


def _grouped(rows: Sequence[EpisodeResult]) -> Iterator[Score]:
    for by, (name_of, order) in _KEYS.items():
        groups: dict[str, list[EpisodeResult]] = {}
        for row in rows:
            groups.setdefault(name_of(row), []).append(row)
        for name in _ordered(groups, order):
            yield score(by, name, groups[name])


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
    gaps = [float(true.success) - float(other.success) for true, other in pairs]
    return Ablation(
        variant=variant,
        by=by,
        n=len(pairs),
        success=share_of(sum(other.success for _, other in pairs), len(pairs)),
        gap=means_of({"gap": gaps})["gap"],
        p=mcnemar_p(sum(gap > 0 for gap in gaps), sum(gap < 0 for gap in gaps)),
    )
