"""Builds scene packages from built-in layouts and from the user's scene files. Workers read the packages only.

Importing this package does not load USD; `factory.scenes.compile.compiler` loads it.
"""

from factory.scenes.build import build_scene, import_scene, package_path
from factory.scenes.topdown import draw_topdown, encode_topdown

__all__ = ["build_scene", "draw_topdown", "encode_topdown", "import_scene", "package_path"]
