"""Reads SDFormat: `worlds` reads includes and models, `frames` poses, `shapes` geometry and materials."""
