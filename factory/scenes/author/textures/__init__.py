"""Recipes of procedural textures, 512 px square: surfaces, rugs, pictures, window views. Do not read or write files."""

from factory.scenes.author.textures.surfaces import TEXTURES, draw_texture

__all__ = ["TEXTURES", "draw_texture"]
