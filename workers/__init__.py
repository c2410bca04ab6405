"""Stateless simulation: world, robot, renderer, expert, rollout; the worker's side of the protocol.

Keeps nothing between jobs but caches keyed by content hash. Import from the modules by name; those listed are for use
from outside.
"""

__all__ = ["attempt", "experts", "grid", "render", "rollout", "settings", "stage", "supervisor", "world"]
