"""Execution of `run`, `render`, `plan` and `gate`."""
