"""Truth: plan expansion, the ledger, the lease protocol, validation and the archive. Never simulates, never renders.

Import from the modules by name; those listed are for use from outside.
"""

__all__ = ["admin", "archive", "check", "dataset", "gateway", "ledger", "plan", "repair", "service", "settings", "wire"]
