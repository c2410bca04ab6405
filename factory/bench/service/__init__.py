"""Benchmarks of the coordinator: ledger, protocol, validation and archive, with simulated workers."""
