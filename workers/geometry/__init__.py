"""Poses, camera projection, occupancy grid and velocity limits. Pure functions."""
