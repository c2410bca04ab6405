"""Formats `lerobot` and `lerobot-v2.1`: LeRobot datasets of version 3.0 and 2.1. Does not need the package lerobot.

Both versions have the same columns, statistics and videos, which `piece` writes per episode; `v30` and `v21` write
their file layouts.
"""
