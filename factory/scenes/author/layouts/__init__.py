"""Layouts of the built-in scenes: rooms, walls and the placement of props."""
