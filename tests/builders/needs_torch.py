"""Skips tests that need PyTorch if it is not installed and names its extra."""

from __future__ import annotations

import importlib.util

import pytest

_MISSING = [name for name in ("torch", "tensorboard") if importlib.util.find_spec(name) is None]

needs_torch = pytest.mark.skipif(
    bool(_MISSING), reason=f"no {' and no '.join(_MISSING)}: the extra `train` brings them; make test-train installs it"
)
