"""Read-only queries of a ledger: audits, progress and records."""
