"""Trains the baseline policies. Networks need the extra `train` (PyTorch).

Vocabulary, labels, cache and learning rate schedule use numpy only; torch is imported only to build or load a network.
"""

from __future__ import annotations

from factory.train.options import BcOptions
from factory.train.report import EpochMeasures, TrainReport

__all__ = ["BcOptions", "EpochMeasures", "TrainReport"]
