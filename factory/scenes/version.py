"""Version of the scene compiler, in a separate module so that cache look-ups do not load USD."""

COMPILER_VERSION = 11
"""Incremented when the same stage compiles to different bytes."""
IMPORT_VERSION = 5
"""Incremented when imports in a cache must be compiled again. In version 1, the cache key ignored --unit and --up;
in version 2, readers dropped objects that version 3 keeps; in version 3, a sky sphere was part of the scene, and
cut-out textures were drawn solid; in version 4, material scripts of Ogre and `materials/textures` were not read."""
MATERIALS_VERSION = 1
"""Incremented when the recorded materials of the same stage change; the paper's layouts record none."""
