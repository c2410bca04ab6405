"""Defaults of the coordinator that its command line shows. Imports nothing, so help pages are shown fast.

Design: docs/design/program.md#a-command-imports-its-work-when-it-runs.
"""

from __future__ import annotations

LEASE_TTL_S = 15.0
"""Duration of a lease without a heartbeat, seconds."""
CHECKPOINT_S = 30.0
"""Interval of writing the dataset's tables, seconds."""
MAX_PULLERS = 64
"""Maximum number of bundles that are transferred and validated at a time."""


def pullers_for(cores: int) -> int:
    """Returns the number of pullers of a coordinator alone on a host: one per core, as each validates on one core."""
    return min(max(2, cores), MAX_PULLERS)
