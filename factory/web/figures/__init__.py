"""Figures of the report for the web page: drawn in a separate process, kept in the cache of the user."""
