"""Training of the baselines that ship with the product; needs the extra `train` (PyTorch) where a network is involved.

Words, labels, cache and schedule are numpy and pure; torch is imported only when a network is built or loaded.
"""

from __future__ import annotations

from factory.train.options import BcOptions
from factory.train.report import EpochMeasures, TrainReport

__all__ = ["BcOptions", "EpochMeasures", "TrainReport"]
