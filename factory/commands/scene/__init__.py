"""Execution of `scene`."""
