"""Expands a plan into its jobs: reads plan files, apportions quotas, draws episodes. Opens no ledger."""
