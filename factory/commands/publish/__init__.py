"""Execution of `export`, `relabel` and `push`."""
