"""Command `train`."""
