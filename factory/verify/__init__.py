"""Verifies the files and tables of a dataset, and inspects damaged datasets for a repair. Changes no files."""
