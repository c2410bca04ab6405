"""Execution of `train`."""
