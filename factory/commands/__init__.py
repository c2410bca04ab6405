"""Executes commands whose options have been parsed. Results go to stdout, logs and progress bars to stderr.

`factory.cli` declares the commands and imports these modules when a command runs.
"""
