"""Compiles USD stages to scene packages: mesh, textures, colliders, floor, occupancy grid, targets."""
