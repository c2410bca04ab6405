"""Subcommands of `factory scene`."""
