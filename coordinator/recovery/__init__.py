"""Rebuilds a ledger from the episodes on disk, and repairs damaged datasets."""
