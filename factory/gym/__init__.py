"""The Gymnasium environment `MiniVLANav-v0`, registered by importing this package. Imports no simulation by itself.

Gymnasium imports the package when a name begins with it:

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
    """Registers the environment; doing so twice is harmless."""
    if ENV_ID not in gymnasium.registry:
        gymnasium.register(ENV_ID, entry_point="factory.gym.env:MiniVLANavEnv")


register_envs()
