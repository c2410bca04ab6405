"""Computes the collider, the floor, the occupancy grid and the reachable targets of a scene. Pure functions."""
