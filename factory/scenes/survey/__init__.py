"""Surveys a compiled floor: spawn points and their quality. Pure and deterministic."""
