"""Scenes: authored or imported as USD, compiled once into packages that workers need nothing else for.

Importing this package does not load USD; `factory.scenes.compile.compiler` and what stands below it do.
"""

from factory.scenes.build import build_scene, import_scene, package_path
from factory.scenes.topdown import draw_topdown, encode_topdown

__all__ = ["build_scene", "draw_topdown", "encode_topdown", "import_scene", "package_path"]
