"""Referring expressions: scene graph, grammar, generator and verifier. Pure functions (docs/language.md).

The package is in `schemas`, because the coordinator verifies instructions and may import neither `factory` nor
`workers`.
"""
