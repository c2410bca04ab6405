"""Compiles extracted scenes to scene packages: mesh, textures, objects, targets. Grids are in `scenes.navigation`."""
