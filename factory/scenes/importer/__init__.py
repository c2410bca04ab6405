"""Imports USD stages: visible and collision geometry as arrays in metres, z up. Only this package reads USD.

Importing the package loads the models only; `extract` loads OpenUSD.
"""

from factory.scenes.importer.content import Cutout, Extraction, Part, Surface, TextureRecipe

__all__ = ["Cutout", "Extraction", "Part", "Surface", "TextureRecipe"]
