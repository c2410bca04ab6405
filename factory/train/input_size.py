"""Sizes and version of the network input. Imports nothing, so options can name them."""

from __future__ import annotations

PREPROCESS_VERSION = 1
"""Version of `preprocess`. Increase it with any change, so old caches and policies are not reused."""
SIZES = (64, 80, 128, 160)
"""Valid picture sides, pixels; each divides the frame size."""
