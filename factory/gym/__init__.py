"""Registers the Gymnasium environment `MiniVLANav-v0` on import. Does not import the simulation.

Gymnasium imports this package when the environment id has its name as a prefix:

>>> import gymnasium  # doctest: +SKIP
>>> env = gymnasium.make("factory.gym:MiniVLANav-v0", data="dataset", split="train_id")  # doctest: +SKIP
"""

from __future__ import annotations

from schemas.support.extras import missing_package

try:
    import gymnasium
except ImportError as error:
    raise ImportError(str(missing_package("gymnasium", "factory.gym"))) from error

__all__ = ["ENV_ID", "register_envs"]

ENV_ID = "MiniVLANav-v0"


def register_envs() -> None:
    """Registers the environment; can be called more than once."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(ENV_ID, entry_point="factory.gym.env:MiniVLANavEnv")


register_envs()
