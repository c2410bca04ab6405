"""Referring expressions: scene graph, grammar, generator and verifier. Pure functions (docs/language.md)."""
