"""`factory bench`: measures the performance of this machine."""

from __future__ import annotations

from factory.cli.other.bench import command

__all__ = ["command"]
