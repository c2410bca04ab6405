"""Figures of the paper, one module each, and their registry. Each `draw` function is pure."""
