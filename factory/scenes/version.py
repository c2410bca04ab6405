"""Version of the scene compiler, in a separate module so that cache look-ups do not load USD."""

COMPILER_VERSION = 11
"""Incremented when the same stage compiles to different bytes."""
IMPORT_VERSION = 2
"""Incremented when imports in a cache must be compiled again. In version 1, the cache key ignored --unit and --up."""
MATERIALS_VERSION = 1
"""Incremented when the recorded materials of the same stage change; the paper's layouts record none."""
