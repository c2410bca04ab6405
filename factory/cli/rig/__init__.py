"""Command `factory rig`."""
