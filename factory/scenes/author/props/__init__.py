"""Geometry of the props of the built-in scenes, and their catalogue."""
