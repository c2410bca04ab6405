"""Executes the benchmarks. Results go to stdout, logs and progress bars to stderr."""
