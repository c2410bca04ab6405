"""Scenes: authored as USD, imported, compiled once into content-hashed packages."""
