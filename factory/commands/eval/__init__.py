"""Execution of `eval`."""
