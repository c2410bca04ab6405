"""Benchmarks of workers and of whole runs: rollout, rendering, memory, and plain PyBullet for comparison."""
