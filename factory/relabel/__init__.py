"""Adds new verified instructions to a copy of a dataset, without new simulations (docs/language.md)."""
