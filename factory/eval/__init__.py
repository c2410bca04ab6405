"""Closed-loop evaluation: specs of episodes, a stepping simulator, policies, metrics with intervals, results on disk.

A result is a pure function of spec, policy and software, whoever runs it and in which order.
"""

from __future__ import annotations

__all__ = [
    "ablation",
    "action",
    "compare",
    "estimate",
    "measure",
    "policy",
    "result",
    "rollout",
    "run",
    "score",
    "simulator",
    "spec",
    "store",
]
