"""Execution of the commands that read a dataset or a run."""
