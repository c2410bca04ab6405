"""Logs, settings and endpoints of the command line."""
