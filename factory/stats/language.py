"""Computes language statistics: whether the target can be found without language, clarity and variety of instructions.

Self-BLEU: Zhu et al., "Texygen: A Benchmarking Platform for Text Generation Models", SIGIR 2018; the mean BLEU-4
(Papineni et al., ACL 2002) of each sentence with all others as references, smoothed:
near 0 if the sentences have no words in common, 1 if they are equal. Pure functions; no I/O.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from factory.stats.measures import mean_of, share_of
from factory.stats.rollouts import ALL
from factory.stats.statistics import (
    ArrivalRow,
    FeatureRow,
    LanguageRow,
    LanguageStatistics,
    PatternRow,
    Remark,
    Share,
    WordingRow,
)
from schemas.dataset.rows import EpisodeSummary
from schemas.instruction.start_view import IN_FRONT_RAD, SeenObject
from schemas.instruction.templates import says_in_front
from schemas.language.language_file import LanguageSpec
from schemas.language.sentence.grammar import LANGUAGES

_MOST_COMPARED = 300
"""Maximum number of sentences of a language that are compared for self-BLEU, evenly spaced among all sentences."""
_ORDERS = 4
_SMOOTH = 0.1
"""Count used instead of 0 for an n-gram order without a match (method 1 of Chen and Cherry, WMT 2014)."""
_WORD = re.compile(r"[\u3400-\u9fff]|[^\W\d_]+(?:['’-][^\W\d_]+)*|\d+")
"""A word, or one Chinese character."""
NGrams = Counter[tuple[str, ...]]


def words_of(sentence: str) -> list[str]:
    """Returns the words of a sentence in lower case; in Chinese its characters."""
    return _WORD.findall(sentence.lower())


def wording_row(language: str, sentences: Sequence[str]) -> WordingRow:
    split = [words_of(sentence) for sentence in sentences]
    lengths = [len(words) for words in split]
    chosen = split[:: max(1, math.ceil(len(split) / _MOST_COMPARED))]
    return WordingRow(
        language=language,
        n=len(sentences),
        distinct=len(set(sentences)),
        vocabulary=len({word for words in split for word in words}),
        words_mean=mean_of(lengths),
        words_least=min(lengths, default=0),
        words_most=max(lengths, default=0),
        self_bleu=self_bleu(chosen),
    )


def self_bleu(sentences: Sequence[Sequence[str]]) -> float | None:
    """Returns the mean BLEU-4 of each sentence with all others as references; `None` for fewer than two sentences."""
    if len(sentences) < 2:
        return None
    grams = [[_grams(words, order) for words in sentences] for order in range(1, _ORDERS + 1)]
    limits = [_two_largest(each) for each in grams]
    lengths = Counter(map(len, sentences))
    scores = []
    for number, words in enumerate(sentences):
        parts = [_precision(grams[order][number], limits[order]) for order in range(_ORDERS) if len(words) > order]
        mean = math.exp(sum(map(math.log, parts)) / len(parts)) if parts else 0.0
        scores.append(_brevity(len(words), lengths) * mean)
    return mean_of(scores)


def _grams(words: Sequence[str], order: int) -> NGrams:
    return Counter(tuple(words[place : place + order]) for place in range(len(words) - order + 1))


def _two_largest(sentences: Sequence[NGrams]) -> dict[tuple[str, ...], tuple[int, int]]:
    """Counts each n-gram in every sentence; returns its two largest counts, the largest first."""
    largest: dict[tuple[str, ...], tuple[int, int]] = {}
    for grams in sentences:
        for gram, count in grams.items():
            first, second = largest.get(gram, (0, 0))
            largest[gram] = (count, first) if count > first else (first, max(second, count))
    return largest


def _precision(grams: NGrams, limits: dict[tuple[str, ...], tuple[int, int]]) -> float:
    """Returns the clipped n-gram precision of BLEU: a sentence's share of n-grams that occur in another sentence."""
    matched = 0
    for gram, count in grams.items():
        first, second = limits[gram]
        matched += min(count, second if count == first else first)
    return (matched or _SMOOTH) / sum(grams.values())


def _brevity(length: int, lengths: Counter[int]) -> float:
    """Returns the brevity penalty of BLEU; the reference is the other sentence whose length is nearest."""
    others = [other for other, count in lengths.items() if other != length or count > 1]
    nearest = min(others, key=lambda other: (abs(other - length), other))
    return 1.0 if length >= nearest else math.exp(1 - nearest / max(length, 1))


@dataclass(frozen=True)
class EpisodeView:
    """Objects that the instruction of an episode fits, and objects in view."""

    row: EpisodeSummary
    target: int
    """Id of the target."""
    of_category: frozenset[int]
    """Ids of all objects of the scene that have the target's category."""
    fitting: frozenset[int]
    """Ids of all objects of the scene that the instruction fits."""
    seen: tuple[SeenObject, ...]
    """Objects with a category in view in the first frame."""
    is_in_view_at_end: bool
    """Whether the target is in view in the last frame."""
    choices: frozenset[int] = frozenset()
    """Ids of the objects from which the target was drawn at the start; empty if the plan names the target."""
    features: frozenset[str] | None = None
    """Features of the verified instruction; `None` for a template."""

    @property
    def language(self) -> str:
        """Code of the language of the instruction."""
        code = self.row.template_id.partition("_")[0]
        return code if code in LANGUAGES else "en"


def summarise_language(
    dataset: str,
    run: str,
    scenes: Iterable[str],
    episodes: int,
    views: Sequence[EpisodeView],
    remarks: Sequence[Remark] = (),
    spec: LanguageSpec | None = None,
) -> LanguageStatistics:
    """Returns the language statistics of episodes.

    Args:
        dataset: Name of the dataset.
        run: Name of the run.
        scenes: Scene names of the plan.
        episodes: Number of episodes of the dataset.
        views: Episodes whose frames were read.
        remarks: Remarks about omitted data.
        spec: Language that the plan asks for; `None` for templates and relabelled datasets.
    """
    languages = Counter(view.language for view in views)
    wrong, views = [view for view in views if not view.fitting], [view for view in views if view.fitting]
    texts = [(view.language, view.row.instruction) for view in (*views, *wrong)]
    names = list(dict.fromkeys([*scenes, *(view.row.scene for view in views)]))
    categories = [name for name, _ in Counter(view.row.target_category for view in views).most_common()]
    return LanguageStatistics(
        dataset=dataset,
        run=run,
        episodes=episodes,
        read=len(texts),
        instructions=len({text for _, text in texts}),
        remarks=tuple(remarks),
        rows=(*(_row(name, [view for view in views if view.row.scene == name]) for name in names), _row(ALL, views)),
        arrivals=tuple(
            ArrivalRow(
                group=name,
                in_view=_share(
                    [v for v in views if name in (ALL, v.row.target_category)], lambda v: v.is_in_view_at_end
                ),
            )
            for name in (*categories, ALL)
        ),
        wording=tuple(
            wording_row(code, [text for other, text in texts if other == code]) for code, _ in languages.most_common()
        ),
        unique=_share(views, lambda view: len(view.fitting) == 1),
        others_in_scene=mean_of([len(view.of_category) - 1 for view in views]),
        false_premises=len(wrong),
        features=_feature_rows(views, spec),
        patterns=tuple(
            PatternRow(pattern=name, realised=share_of(count, len(views)))
            for name, count in Counter(view.row.template_id for view in views).most_common()
        ),
    )


def _feature_rows(views: Sequence[EpisodeView], spec: LanguageSpec | None) -> tuple[FeatureRow, ...]:
    written = [view.features for view in views if view.features is not None]
    asked = {} if spec is None else spec.feature_shares
    limits = {} if spec is None else {str(name): share for name, share in spec.largest_shares.items()}
    counts = Counter(name for features in written for name in features)
    names = sorted({*counts, *asked}, key=lambda name: (-counts[name], name)) if written else []
    return tuple(
        FeatureRow(
            feature=name,
            asked=None if spec is None else asked.get(name, 0.0),
            largest=limits.get(name),
            realised=share_of(counts[name], len(written)),
        )
        for name in names
    )


def _row(group: str, views: Sequence[EpisodeView]) -> LanguageRow:
    in_front = [view for view in views if says_in_front(view.row.template_id)]
    return LanguageRow(
        group=group,
        n=len(views),
        nearest=_share(views, lambda view: _first(view.seen, _range) == view.target),
        central=_share(views, lambda view: _first(view.seen, _bearing) == view.target),
        central_of_category=_share(views, lambda view: _first(_alike(view), _bearing) == view.target),
        nearest_of_category=_share(views, lambda view: _first(_alike(view), _range) == view.target),
        largest_of_category=_share(views, lambda view: _first(_alike(view), _smallness) == view.target),
        chance=mean_of([_chance(view) for view in views]),
        others_in_view=mean_of([sum(each.id != view.target for each in _alike(view)) for view in views]),
        several_in_scene=_share(views, lambda view: len(view.fitting) > 1),
        several_in_view=_share(views, lambda view: sum(each.id in view.fitting for each in view.seen) > 1),
        contradictory=_share(views, lambda view: bool(_alike(view)) and _target(view) is None),
        not_in_front=_share(in_front, lambda view: not _is_in_front(view)),
    )


def _share(views: Sequence[EpisodeView], holds: Callable[[EpisodeView], bool]) -> Share:
    return share_of(sum(map(holds, views)), len(views))


def _first(seen: Sequence[SeenObject], measure: Callable[[SeenObject], float]) -> int | None:
    return min(seen, key=measure).id if seen else None


def _range(seen: SeenObject) -> float:
    return seen.range_m


def _bearing(seen: SeenObject) -> float:
    return abs(seen.bearing_rad)


def _smallness(seen: SeenObject) -> float:
    return -seen.pixels


def _alike(view: EpisodeView) -> list[SeenObject]:
    """Returns the objects in view that are in `choices` or, if it is empty, have the target's category."""
    return [each for each in view.seen if each.id in (view.choices or view.of_category)]


def _chance(view: EpisodeView) -> float:
    """Returns the probability that an object chosen at random from `_alike` is the target."""
    alike = _alike(view)
    return 1 / len(alike) if any(each.id == view.target for each in alike) else 0.0


def _target(view: EpisodeView) -> SeenObject | None:
    return next((each for each in view.seen if each.id == view.target), None)


def _is_in_front(view: EpisodeView) -> bool:
    row = view.row
    direction = math.atan2(row.goal_y_m - row.spawn_y_m, row.goal_x_m - row.spawn_x_m)
    bearing = math.remainder(direction - row.spawn_yaw_rad, 2 * math.pi)
    return _target(view) is not None and abs(bearing) <= IN_FRONT_RAD
