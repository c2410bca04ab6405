"""Decides which objects an expression fits. Imports nothing of the generator."""
