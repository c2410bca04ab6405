"""Bakes light maps: unwraps the visible surfaces, casts rays from their texels and tone-maps the result."""

from factory.scenes.light.bake import LAYOUT_DETAIL, USUAL_DETAIL, LightDetail, LightMap, bake_light
from factory.scenes.light.charts import TooManyPieces

__all__ = ["LAYOUT_DETAIL", "USUAL_DETAIL", "LightDetail", "LightMap", "TooManyPieces", "bake_light"]
