"""Verifies the files and tables of a dataset."""
