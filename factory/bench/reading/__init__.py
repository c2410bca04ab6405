"""Benchmarks of a finished dataset: frames, large tables, and the web page. A dataset can be synthetic."""
