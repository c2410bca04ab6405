"""Configures logging, reads user settings, and validates network endpoints for the command line."""
