"""The Gymnasium environment `MiniVLANav-v0`, registered by importing this module.

Gymnasium imports the module when an id begins with its name:

>>> import gymnasium  # doctest: +SKIP
>>> env = gymnasium.make("minivla.gym:MiniVLANav-v0", data="dataset", split="train_id")  # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from minivla.packages import require_own_packages

try:
    from gymnasium.envs import registration
except ImportError as error:
    require_own_packages()
    from schemas.support.extras import missing_package

    raise ImportError(str(missing_package("gymnasium", "minivla.gym"))) from error

if TYPE_CHECKING:
    from factory.gym.env import MiniVLANavEnv

ENV_ID = "MiniVLANav-v0"


def register() -> None:
    """Registers the environment; further calls have no effect."""
    if ENV_ID not in registration.registry:
        registration.register(ENV_ID, entry_point="minivla.gym:make_env")


def make_env(**options: Any) -> MiniVLANavEnv:
    """Creates the environment; `factory.gym.env.MiniVLANavEnv` documents the options.

    Raises:
        ImportError: a foreign package hides a package of the product.
        UsageError: an option is not valid, or PyBullet is not installed.
    """
    require_own_packages()
    from factory.gym.env import MiniVLANavEnv

    return MiniVLANavEnv(**options)


register()
