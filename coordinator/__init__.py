"""Coordinator of a run: plan expansion, ledger, lease protocol, validation and archive.

The package does not simulate and does not render. Import from the modules by name.
"""
