"""Execution of `rig`."""
