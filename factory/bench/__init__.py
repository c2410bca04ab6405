"""Benchmarks of rollout, rendering, memory, coordinator and dataset reader, with fixed workloads.

Returns models with medians and spreads. Prints nothing and asserts no times.
"""
