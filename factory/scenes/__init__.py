"""Scenes: authored or imported as USD, compiled once into packages that workers need nothing else for."""

from factory.scenes.build import build_scene, import_scene, package_path
from factory.scenes.compile import COMPILER_VERSION, compile_stage
from factory.scenes.topdown import draw_topdown, encode_topdown

__all__ = [
    "COMPILER_VERSION",
    "build_scene",
    "compile_stage",
    "draw_topdown",
    "encode_topdown",
    "import_scene",
    "package_path",
]
