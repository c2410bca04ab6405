"""Benchmarks of the loop, its parts, the ledger and the reader: repeatable work, medians with their spread.

Measures and returns models; prints nothing, asserts nothing about a time.
"""
