"""Writes the Parquet tables, the metadata and the card of a dataset."""
