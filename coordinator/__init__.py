"""Coordinator of a run: plan expansion, ledger, lease protocol, validation and archive.

The package does not simulate and does not render.

Import from the submodules; `__all__` lists those that other packages use.
"""

__all__ = [
    "admin",
    "archive",
    "expansion",
    "gateway",
    "ledger",
    "protocol",
    "recovery",
    "service",
    "settings",
    "status",
    "tables",
    "transfer",
    "validation",
]
