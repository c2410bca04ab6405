"""Marker `needs_torch`, which skips a test if PyTorch or TensorBoard is not installed."""

from __future__ import annotations

import importlib.util

import pytest

_MISSING = [name for name in ("torch", "tensorboard") if importlib.util.find_spec(name) is None]

needs_torch = pytest.mark.skipif(
    bool(_MISSING), reason=f"{' and '.join(_MISSING)} not installed: install the extra `train` or run make test-train"
)
