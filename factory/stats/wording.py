"""Computes the variety of instructions: sentences, vocabulary, length and self-BLEU. Pure functions of texts.

Self-BLEU: Zhu et al., "Texygen: A Benchmarking Platform for Text Generation Models", SIGIR 2018; the mean BLEU-4
(Papineni et al., ACL 2002) of each sentence with all others as references, smoothed:
near 0 if the sentences have no words in common, 1 if they are equal.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence

from factory.stats.measures import mean_of
from factory.stats.model import WordingRow

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
    """Returns the measures of the sentences of one language."""
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
    found = [[_grams(words, order) for words in sentences] for order in range(1, _ORDERS + 1)]
    limits = [_two_largest(each) for each in found]
    lengths = Counter(map(len, sentences))
    scores = []
    for number, words in enumerate(sentences):
        parts = [_precision(found[order][number], limits[order]) for order in range(_ORDERS) if len(words) > order]
        mean = math.exp(sum(map(math.log, parts)) / len(parts)) if parts else 0.0
        scores.append(_brevity(len(words), lengths) * mean)
    return mean_of(scores)


def _grams(words: Sequence[str], order: int) -> NGrams:
    return Counter(tuple(words[place : place + order]) for place in range(len(words) - order + 1))


def _two_largest(sentences: Sequence[NGrams]) -> dict[tuple[str, ...], tuple[int, int]]:
    """Counts each n-gram in every sentence; returns its two largest counts, the largest first."""
    found: dict[tuple[str, ...], tuple[int, int]] = {}
    for grams in sentences:
        for gram, count in grams.items():
            first, second = found.get(gram, (0, 0))
            found[gram] = (count, first) if count > first else (first, max(second, count))
    return found


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
