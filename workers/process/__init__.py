"""Starts simulation processes and exchanges JSON lines with them."""
