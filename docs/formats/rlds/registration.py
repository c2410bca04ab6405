"""Standardisation transforms of `minivla_nav` for OpenVLA and Octo; copy or import them there. Needs tensorflow only.

A trajectory has the steps of an episode, stacked: `action` (T, 2), `observation` with `image` and `state` (T, 5).
"""

from __future__ import annotations

from typing import Any

import tensorflow as tf

OPENVLA_CONFIG: dict[str, Any] = {
    "image_obs_keys": {"primary": "image", "secondary": None, "wrist": None},
    "depth_obs_keys": {"primary": "depth", "secondary": None, "wrist": None},
    "state_obs_keys": ["eef_state", None, "gripper_state"],
}
"""Entry of `OXE_DATASET_CONFIGS` without the two enumerations, see README.md."""
OCTO_KWARGS: dict[str, Any] = {
    "name": "minivla_nav",
    "image_obs_keys": {"primary": "image"},
    "proprio_obs_key": "proprio",
    "language_key": "language_instruction",
    "action_proprio_normalization_type": "normal",
}
"""Arguments of `make_dataset_from_rlds` without `data_dir` and `standardize_fn`, see README.md."""


def openvla_transform(trajectory: dict[str, Any]) -> dict[str, Any]:
    """Puts v and w where arm datasets have the translation along x and the yaw: actions (T, 7), state (T, 6 + 1)."""
    action, state = trajectory["action"], trajectory["observation"]["state"]
    zero = tf.zeros_like(action[:, :1])
    trajectory["action"] = tf.concat((action[:, :1], zero, zero, zero, zero, action[:, 1:], zero), axis=-1)
    pose = (state[:, :2], zero, zero, zero, state[:, 2:3])
    trajectory["observation"]["eef_state"] = tf.concat(pose, axis=-1)
    trajectory["observation"]["gripper_state"] = zero
    return trajectory


def octo_transform(trajectory: dict[str, Any]) -> dict[str, Any]:
    """Names the state as Octo does; actions stay (T, 2), for a new action head with `action_dim=2`."""
    trajectory["observation"]["proprio"] = trajectory["observation"]["state"]
    return trajectory
