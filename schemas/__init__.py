"""Shared data models: configuration, array specs, wire messages, and the codecs of bundles and scenes.

Imports no other package of the product. Import from the modules by name.
"""

__all__ = [
    "arrays",
    "base",
    "bundle",
    "config",
    "container",
    "digest",
    "episode",
    "errors",
    "fingerprint",
    "identity",
    "job",
    "keys",
    "language",
    "lap",
    "measure",
    "ndarray",
    "plan",
    "png",
    "scene",
    "terms",
    "tokens",
    "wire",
]
