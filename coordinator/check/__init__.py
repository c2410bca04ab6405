"""Validation of what workers bring: pure checks, and the sandbox they run in."""
