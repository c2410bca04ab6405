"""Simulation processes, and the JSON lines exchanged with them."""
