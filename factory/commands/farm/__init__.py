"""Execution of the commands of several hosts."""
