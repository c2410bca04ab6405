"""Sizes of frames, pixels. Imports nothing, so command-line options can use it at no cost."""

from __future__ import annotations

FRAME_SIZE_PX = 640
"""Width and height of a recorded frame, pixels."""
MAX_SIZE_PX = 2048
"""Largest width and height of a rendered frame, pixels."""
