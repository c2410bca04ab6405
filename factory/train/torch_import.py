"""Imports PyTorch on first use, or raises an error that names the extra. Builds no networks."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from schemas.errors import UsageError
from schemas.support.extras import missing_package, require_package


def load_torch() -> Any:
    """Returns the module `torch`.

    Raises:
        UsageError: PyTorch is not installed; the message names the extra.
    """
    try:
        return importlib.import_module("torch")
    except ImportError as error:
        raise missing_package("torch", "a training or `bc:` policy") from error


def require_logs() -> None:
    """Raises an error unless training logs can be written.

    Raises:
        UsageError: TensorBoard is not installed.
    """
    require_package("tensorboard", "training")


def summary_writer(folder: str, purge_step: int) -> Any:
    """Returns a TensorBoard writer; hides entries of an earlier run from `purge_step` on.

    Raises:
        UsageError: TensorBoard is not installed.
    """
    load_torch()
    try:
        module = importlib.import_module("torch.utils.tensorboard")
    except ImportError as error:
        raise missing_package("tensorboard", "the log of a training") from error
    return module.SummaryWriter(folder, purge_step=purge_step)


def choose_device(name: str) -> Any:
    """Returns the torch device of that name; `auto` selects a GPU if available.

    Raises:
        UsageError: The device is not available.
    """
    torch = load_torch()
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        first = (str(error).splitlines() or ["unknown"])[0]
        raise UsageError(f"--device {name} is not available ({first}); use auto or cpu") from error
    return device


@contextmanager
def deterministic_algorithms() -> Iterator[None]:
    """Limits PyTorch to algorithms that give the same result in every run, on a GPU too."""
    torch = load_torch()
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # read when cuBLAS is used for the first time
    # with PyTorch's default algorithms, two runs with the same seed on one GPU had different weights
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(True)
    try:
        yield
    finally:
        torch.use_deterministic_algorithms(before)
