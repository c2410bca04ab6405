"""Decides which objects an expression fits. Does not import the generator."""
