"""Light baked into a picture: unwrap the visible surfaces, cast rays at their texels, tone the result."""

from factory.scenes.light.bake import LightMap, bake_light
from factory.scenes.light.unwrap import TooManyPieces

__all__ = ["LightMap", "TooManyPieces", "bake_light"]
