"""The version of the scene compiler, apart from the compiler so that a cache can be searched without loading USD."""

__all__ = ["COMPILER_VERSION"]

COMPILER_VERSION = 9
"""Rises whenever the same stage compiles to other bytes."""
