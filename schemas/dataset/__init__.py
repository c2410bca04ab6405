"""Rows of a dataset's tables, and its description `dataset_meta.json`."""
