"""Writes the job scripts of a run for batch systems, and submits them."""
