"""Execution of the commands for many hosts."""
