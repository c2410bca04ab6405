"""Fetches announced bundles from workers, and has them validated, archived and recorded."""
