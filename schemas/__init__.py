"""The words all sides share: models, array specs, wire messages and the bundle codec.

Imports nothing of ours from outside this package and touches no path. Import from the modules by name.
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
