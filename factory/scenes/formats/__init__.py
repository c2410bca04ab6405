"""Reads scenes of formats other than USD: glTF, OBJ, PLY, STL, COLLADA, SDFormat, URDF and MJCF.

Design: docs/design/scenes.md#a-parser-for-each-format.
"""

from factory.scenes.formats.extract import extract_scene

__all__ = ["extract_scene"]
