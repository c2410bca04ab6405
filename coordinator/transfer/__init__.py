"""Transfers announced bundles from workers, validates them, archives them and records them in the ledger."""
