"""Digests: which changes of an episode change them, and which do not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.encoding.digest import content_digest, dataset_digest, frame_digest

RGB, DEPTH, IDS = np.zeros((4, 4, 3), np.uint8), np.ones((4, 4), np.float32), np.ones((4, 4), np.uint16)
PAIRS = st.dictionaries(st.from_regex(r"ep_[0-9]{6}", fullmatch=True), st.from_regex(r"[0-9a-f]{4}", fullmatch=True))


def test_digest_of_a_frame_is_pinned() -> None:
    """The digest is part of the bundle format: if this value changes, the format needs a new version."""
    assert frame_digest(RGB, DEPTH, IDS) == "9fe2a0aa1da6865030f2d6f338121325"


@pytest.mark.parametrize("which", [0, 1, 2])
def test_every_modality_changes_the_digest(which: int) -> None:
    images = [RGB.copy(), DEPTH.copy(), IDS.copy()]
    images[which][0, 0] = 7
    assert frame_digest(*images) != frame_digest(RGB, DEPTH, IDS)  # type: ignore[arg-type]


def test_memory_layout_does_not_change_the_digest() -> None:
    assert frame_digest(np.asfortranarray(RGB), DEPTH, IDS) == frame_digest(RGB, DEPTH, IDS)


def test_frames_arrays_and_metadata_change_the_digest() -> None:
    base = content_digest(["aa", "bb"], [DEPTH], "{}")
    assert base != content_digest(["bb", "aa"], [DEPTH], "{}")
    assert base != content_digest(["aa", "bb"], [DEPTH + 1], "{}")
    assert base != content_digest(["aa", "bb"], [DEPTH], "{ }")


@given(PAIRS, st.randoms())
def test_dataset_digest_does_not_depend_on_the_order(pairs: dict[str, str], random: object) -> None:
    shuffled = list(pairs.items())
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert dataset_digest(shuffled) == dataset_digest(pairs.items())


def test_dataset_digest_depends_on_the_id_and_the_digest_of_an_episode() -> None:
    assert dataset_digest([("ep_000001", "a")]) != dataset_digest([("ep_000001", "b")])
    assert dataset_digest([("ep_000001", "a")]) != dataset_digest([("ep_000002", "a")])
