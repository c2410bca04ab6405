"""Merges datasets, extends a finished dataset, and repairs datasets with several sources."""
