"""The 7 x 7 grid of action tokens."""

from __future__ import annotations

import numpy as np

from schemas.tokens import GRID_POINTS, V_GRID_MPS, W_GRID_RPS, actions_of, tokens_of


def test_every_token_converts_to_an_action_and_back():
    tokens = np.array([(v, w) for v in range(GRID_POINTS) for w in range(GRID_POINTS)], np.int16)
    assert (tokens_of(actions_of(tokens)) == tokens).all()


def test_standing_still_is_exactly_representable():
    assert (actions_of(tokens_of(np.zeros((1, 2), np.float32))) == 0).all()


def test_a_token_is_the_nearest_grid_point():
    rng = np.random.default_rng(0)
    actions = np.stack([rng.uniform(0, 1, 500), rng.uniform(-1.5, 1.5, 500)], axis=1).astype(np.float32)
    tokens = tokens_of(actions)
    assert (tokens[:, 0] == np.abs(V_GRID_MPS - actions[:, :1]).argmin(axis=1)).all()
    assert (tokens[:, 1] == np.abs(W_GRID_RPS - actions[:, 1:]).argmin(axis=1)).all()


def test_values_beyond_the_range_are_clipped():
    assert tokens_of(np.array([(2.0, -9.0)], np.float32)).tolist() == [[6, 0]]
