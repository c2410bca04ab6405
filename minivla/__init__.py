"""Public API of minivla-factory: read datasets, feed them to PyTorch, and drive episodes as a Gymnasium environment.

>>> import minivla
>>> episode = minivla.sample()[0]  # four episodes that the package contains; minivla.Dataset opens your own
>>> episode.instruction
'If you could, drive to the monitor nearest to the printer.'
>>> episode.frame(0).rgb.shape  # doctest: +SKIP
(640, 640, 3)

A dataset stores frames, or states only, from which the same frames are rendered, byte for byte, when they are read.

Importing this package imports no large dependency; each name is loaded at its first use. It keeps working when another
distribution overwrites `factory/__init__.py`, as factory_boy does. `minivla.gym` registers the Gymnasium environment.
Raises `ImportError` when a foreign package named `factory`, `schemas`, `workers` or `coordinator` hides the product's
package of that name; the message names the foreign package.
"""

from __future__ import annotations

import importlib
import sys
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from minivla.packages import require_own_packages

if TYPE_CHECKING:
    from factory.dataset.reader import Dataset, Episode, Frame
    from factory.dataset.sampler import SceneSampler
    from factory.dataset.torch import ClipDataset, FrameDataset, collate

__all__ = ["ClipDataset", "Dataset", "Episode", "Frame", "FrameDataset", "SceneSampler", "collate", "sample"]

_HOMES = {
    "ClipDataset": "factory.dataset.torch",
    "Dataset": "factory.dataset.reader",
    "Episode": "factory.dataset.reader",
    "Frame": "factory.dataset.reader",
    "FrameDataset": "factory.dataset.torch",
    "SceneSampler": "factory.dataset.sampler",
    "collate": "factory.dataset.torch",
}

_SAMPLE = Path(__file__).with_name("sample_data")

if "gymnasium" in sys.modules:  # registers the environment, so the id `minivla:MiniVLANav-v0` works too
    importlib.import_module("minivla.gym")


def __getattr__(name: str) -> Any:
    """Loads a public name, or returns the version of the installed distribution.

    Raises:
        ImportError: a foreign package hides a package of the product.
    """
    if name == "__version__":
        return metadata.version("minivla-factory")
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    require_own_packages()
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def sample() -> Dataset:
    """Opens the sample that the package contains: two episodes in an office and two in a hospital, recorded as states.

    Its instructions are verified, and it has questions. Frames are rendered when they are read.

    Raises:
        ImportError: a foreign package hides a package of the product.
        UsageError: the installation lacks the files of the sample.
    """
    require_own_packages()
    from factory.dataset.reader import Dataset

    return Dataset(_SAMPLE)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
