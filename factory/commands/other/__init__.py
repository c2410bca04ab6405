"""Execution of `bench`."""
