"""Closed-loop evaluation of policies: episode specs, simulator, policy interface, metrics with intervals, results.

The result of an episode depends only on spec, policy and software, not on the machine or the order of execution.
"""
