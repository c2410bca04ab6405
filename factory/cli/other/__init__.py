"""Command `completion`."""
