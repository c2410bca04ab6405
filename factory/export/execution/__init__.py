"""Execution of an export: selection, size estimate, worker processes, manifest and report. Writes no format."""
