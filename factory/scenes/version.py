"""Version of the scene compiler, in a separate module so that cache look-ups do not load USD."""

COMPILER_VERSION = 11
"""Incremented when the same stage compiles to different bytes."""
