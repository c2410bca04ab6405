"""Helpers without knowledge of the domain: child processes, missing packages, closing, repeated log events."""
