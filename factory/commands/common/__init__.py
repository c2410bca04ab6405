"""Changes of the plans that the benchmarks run."""
