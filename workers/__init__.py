"""Stateless simulation (world, robot, renderer, expert, rollout) and the worker's side of the protocol.

Keeps no state between jobs except caches keyed by content hash. Import from the modules by name.
"""
